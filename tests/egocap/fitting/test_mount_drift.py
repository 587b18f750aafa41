"""A slow drift and a jump of the mount behind noisy estimates; a track that follows them."""

from dataclasses import replace

import numpy as np
import pytest

from egocap.errors import InputError
from egocap.fitting.fit_rig import moved_rig
from egocap.fitting.mount_drift import smoothed, split, track_with_drift
from egocap.pose.config import TrackerConfig
from egocap.track.tracker import Tracker

SPREAD = np.repeat([np.deg2rad(2.0), 0.002], 3)


def estimates(truth, seed=0):
    """Estimates of windows with a common constant, and their stated covariances."""
    rng = np.random.default_rng(seed)
    constant = np.repeat([np.deg2rad(4.0), 0.01], 3)
    found = truth + constant + SPREAD * rng.standard_normal(truth.shape)
    return found, np.tile(np.diag(SPREAD**2), (len(truth), 1, 1))


def test_no_drift_is_none():
    times = 5.0 * np.arange(24)
    drift = smoothed(times, *estimates(np.zeros((24, 6))))
    assert drift.jumps == ()
    assert np.linalg.norm(drift.shift[:, 3:], axis=1).max() < 0.003
    assert np.all(np.abs(drift.shift) < 4 * drift.std)


def test_slow_drift_is_followed():
    times = 5.0 * np.arange(24)
    truth = np.zeros((24, 6))
    truth[:, 3] = np.linspace(0.0, 0.012, 24)
    drift = smoothed(times, *estimates(truth))
    assert drift.jumps == ()
    assert abs(drift.shift[-1, 3] - 0.012) < 0.004
    assert np.all(np.abs(drift.shift - truth) < 4 * drift.std)


@pytest.mark.parametrize("seed", range(3))
def test_jump_is_found_where_it_was(seed):
    times = 5.0 * np.arange(16)
    truth = np.zeros((16, 6))
    truth[9:, 3:] = [0.02, 0.0, -0.015]
    drift = smoothed(times, *estimates(truth, seed))
    assert drift.jumps == (9,)
    assert np.linalg.norm(drift.shift[-1, 3:] - truth[-1, 3:]) < 0.006
    assert any("jumped by 2" in line and "40 and 45 s" in line for line in drift.lines())


def test_windows_hold_every_frame_once():
    times = np.arange(0.0, 23.0, 0.1)
    windows = split(times)
    assert len(windows) == 4
    assert np.array_equal(np.concatenate(windows), np.arange(len(times)))
    with pytest.raises(InputError, match=r"in 8.0 s of footage \(valid: 10 s"):
        split(np.arange(0.0, 8.05, 0.1))


def test_a_slipped_rig_is_tracked_better_than_as_given(slow_motion):
    """The rig slips by 36 mm in the second half, unknown to the tracker."""
    slip = np.array([0.0, 0.0, 0.0, -0.03, 0.0, 0.02])
    slipped = replace(slow_motion, rig=moved_rig(slow_motion.rig, slip))
    first, second = slow_motion.detect("simulated:1.0"), slipped.detect("simulated:1.0")
    half = len(first.times) // 2
    parts = {name: np.concatenate([getattr(first, name)[:half], getattr(second, name)[half:]])
             for name in ("points", "valid", "sigma", "confidence")}  # fmt: skip
    found = replace(first, modes=None, mode_weights=None, **parts)
    config = TrackerConfig(multistart=False)
    track, drift = track_with_drift(found, slow_motion.rig, slow_motion.person, config)
    given = Tracker(slow_motion.rig, slow_motion.person, config).track(found)
    assert np.array_equal(track.times, slow_motion.times)
    assert drift.jumps == (2,)
    own, other = (slow_motion.errors(t)[half:].mean() for t in (track, given))
    assert own < 0.9 * other
    assert track.config["mount_drift"]["jumps_s"] == [pytest.approx(10.4, abs=0.2)]
