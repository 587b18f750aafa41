"""Tracks at even times."""

from dataclasses import replace

import numpy as np
import pytest

from egocap.body.skeleton import forward
from egocap.data.bvh import bvh_text
from egocap.data.resampling import evenly, typical_step
from egocap.data.track import Track
from egocap.errors import InputError
from egocap.geometry import axis_angle, rigid
from tests.egocap.conftest import make_motion


def uneven():
    """A live run: a made motion at times that jitter, with a gap."""
    made = make_motion(frames=60)
    rng = np.random.default_rng(0)
    times = np.delete(made.times + rng.uniform(-0.008, 0.008, 60), [20, 21, 22])
    angles = np.stack([np.interp(times, made.times, a) for a in made.angles.T], 1)
    turned = np.stack([axis_angle(np.array([0.0, 0.0, 1.0]), 2.0 * t) for t in times])
    world = rigid(turned, np.stack([times, 0 * times, 0 * times], -1))
    count = len(times)
    return made, Track(
        times=times, angles=angles, joints_head=forward(made.person, angles),
        energy=np.zeros(count), converged=np.ones(count, bool), detections_used=np.zeros(count),
        seconds_per_frame=0.0, config={}, offsets=made.person.offsets, T_world_head=world,
    )  # fmt: skip


def test_uneven_times_become_even_and_the_motion_stays():
    made, track = uneven()
    with pytest.raises(InputError, match="not evenly spaced"):
        bvh_text(track)
    even = evenly(track)
    assert np.ptp(np.diff(even.times)) < 1e-9 and abs(even.times[-1] - track.times[-1]) < 0.04
    true = np.stack([np.interp(even.times, made.times, a) for a in made.angles.T], 1)
    assert np.abs(even.angles - true).max() < 0.05  # linear across the gap
    np.testing.assert_allclose(even.joints_head, forward(made.person, even.angles))
    np.testing.assert_allclose(even.T_world_head[:, 0, 3], even.times, atol=1e-9)
    assert bvh_text(even).count("\n") > len(even.times)


def test_a_rate_can_be_chosen_and_even_tracks_stay():
    track = uneven()[1]
    assert len(evenly(track, fps=60.0).times) == int(60 * np.ptp(track.times)) + 1
    even = evenly(track)
    assert evenly(even) is even
    with pytest.raises(InputError, match="do not increase"):
        evenly(replace(track, times=track.times[::-1].copy()))
    far = np.concatenate([track.times[:-1], [1e11]])
    with pytest.raises(InputError, match=r"span 1e\+11 s, .* even steps \(valid: at most 100,000"):
        evenly(replace(track, times=far))


@pytest.mark.parametrize("dropped", [[], [100]])
@pytest.mark.parametrize("fps", [24, 30, 60, 120])
def test_the_step_of_times_in_whole_milliseconds_is_that_of_the_rate(fps, dropped):
    times = np.delete(np.round(np.arange(300) / fps, 3), dropped)
    assert typical_step(times) == pytest.approx(1 / fps, rel=2e-3)


@pytest.mark.parametrize("steps", [[1 / 30, 1 / 20] * 20, [1 / 30, 1 / 10]])
def test_typical_step_of_steps_of_two_kinds_is_one_of_them(steps):
    """As of films shown two and three fields in turn; their mean is near neither."""
    assert typical_step(np.cumsum([0.0, *steps])) == pytest.approx(1 / 30)
