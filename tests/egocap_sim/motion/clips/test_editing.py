"""Variants of clips keep what they are made of."""

import numpy as np
import pytest

from egocap.errors import InputError
from egocap_sim.core.bodies import INDEX
from egocap_sim.motion.clips.editing import change_speed, fit_to_figure, join_clips, mirror, trim
from egocap_sim.motion.generators.registry import make_motion
from egocap_sim.motion.kinematics.clip import Clip


@pytest.fixture(scope="module")
def clip() -> Clip:
    return make_motion("gestures", 6.0, np.random.default_rng(3))


def test_a_mirrored_clip_swaps_the_sides_and_twice_is_itself(clip):
    other = mirror(clip)
    left, right = INDEX["l_hand"], INDEX["r_hand"]
    assert np.allclose(other.positions[:, right], clip.positions[:, left] * [1, -1, 1])
    again = mirror(other)
    assert np.allclose(again.positions, clip.positions)
    assert np.allclose(again.rotations, clip.rotations)
    assert np.allclose(np.linalg.det(other.rotations), 1)
    assert np.allclose(fit_to_figure(other).positions, other.positions, atol=1e-6)


def test_a_part_is_as_long_as_asked_and_no_longer_than_there_is(clip):
    part = trim(clip, 2.0, 1.5)
    assert (len(part.positions) - 1) / part.fps == pytest.approx(1.5, abs=0.02)
    assert np.array_equal(part.positions[0], clip.positions[round(2.0 * clip.fps)])
    with pytest.raises(InputError, match="beyond the end"):
        trim(clip, 5.9, 1.0)


def test_a_hurried_clip_takes_less_time(clip):
    assert change_speed(clip, 1.25).fps == clip.fps * 1.25


def test_a_joined_clip_begins_as_one_ends_as_the_other_and_never_jumps(clip):
    walk = make_motion("walk", 4.0, np.random.default_rng(5), 90.0)
    both = join_clips(trim(clip, 0.5, 2.0), walk)
    assert both.fps == clip.fps and len(both.positions) / both.fps == pytest.approx(6.0, abs=0.1)
    assert np.allclose(both.rotations[0], clip.rotations[round(0.5 * clip.fps)])
    step = np.linalg.norm(np.diff(both.positions, axis=0), axis=-1).max() * both.fps
    assert step < 6.0  # m/s
    feet = [INDEX["l_foot"], INDEX["r_foot"]]
    seam = slice(round(1.9 * both.fps), round(2.1 * both.fps))
    slid = np.linalg.norm(np.diff(both.positions[seam, feet], axis=0), axis=-1).max() * both.fps
    assert slid < 0.3


@pytest.mark.parametrize("start_s", [1.5, 2.25, 2.75, 3.0])
def test_legs_in_full_stride_do_not_jump_at_a_join(start_s):
    walk = make_motion("walk", 8.0, np.random.default_rng(5))
    both = join_clips(trim(walk, 1.0, 1.5 + start_s / 3), trim(walk, start_s, 2.0))
    fastest, joined = (
        np.linalg.norm(np.diff(clip.positions, axis=0), axis=-1).max() * clip.fps
        for clip in (walk, both)
    )
    assert joined < 1.1 * fastest
