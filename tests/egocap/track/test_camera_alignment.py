"""Views that lag or are turned: both are found again, and the track gains by it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from egocap.body.skeleton import forward
from egocap.detect.synthetic import ProjectedJoints, simulate_detections
from egocap.geometry import axis_angle
from egocap.pose.config import TrackerConfig
from egocap.track.tracker import Tracker

TURN = np.deg2rad([0.5, -0.4, 0.6])


def detect(motion, *, lag=0.0, turn=None, sigma=1.0, hidden=0.2, seed=0):
    """Detections where the second view sees later, by cameras turned against those of the rig."""
    later = forward(motion.person, CubicSpline(motion.times, motion.angles)(motion.times + lag))
    rig = motion.rig
    if turn is not None:
        mount = rig.mounts[1]
        R = axis_angle(turn / np.linalg.norm(turn), np.linalg.norm(turn))
        T = mount.T_head_camera.copy()
        T[:3, :3] = R @ T[:3, :3]
        rig = replace(rig, mounts=(rig.mounts[0], replace(mount, T_head_camera=T)))
    (first, _), (seen_first, _) = (a[:2] for a in rig.project(motion.joints))
    (_, second), (_, seen_second) = (a[:2] for a in rig.project(later))
    pixels, seen = np.stack([first, second], 1), np.stack([seen_first, seen_second], 1)
    rng = np.random.default_rng(seed)
    visible = seen & (rng.random(seen.shape) >= hidden)
    source = f"simulated:{sigma}"
    return simulate_detections(
        ProjectedJoints(pixels, visible, seen, motion.times, (640, 512)), source, rng
    )


@pytest.mark.parametrize("lag", [0.04, -0.02, 0.0])
def test_a_lag_is_found(motion, lag):
    found = detect(motion, lag=lag)
    plain = Tracker(motion.rig, motion.person).track(found)
    result = Tracker(motion.rig, motion.person, TrackerConfig(synchronise=True)).track(found)
    assert result.config["estimated"]["lag_s"][0] == 0.0
    assert result.config["estimated"]["lag_s"][1] == pytest.approx(lag, abs=0.004)
    if abs(lag) > 0.03:
        assert motion.errors(result).mean() < motion.errors(plain).mean()


def test_a_turned_camera_is_found(motion):
    found = detect(motion, turn=TURN)
    plain = Tracker(motion.rig, motion.person).track(found)
    result = Tracker(motion.rig, motion.person, TrackerConfig(align_cameras=True)).track(found)
    rotation = np.deg2rad(result.config["estimated"]["rotation_deg"])
    assert np.allclose(rotation[0], 0)
    assert np.linalg.norm(rotation[1] - TURN) < 0.35 * np.linalg.norm(TURN)
    assert motion.errors(result).mean() < motion.errors(plain).mean()


def test_both_at_once(motion):
    config = TrackerConfig(synchronise=True, align_cameras=True)
    result = Tracker(motion.rig, motion.person, config).track(detect(motion, lag=0.03, turn=TURN))
    assert result.config["estimated"]["lag_s"][1] == pytest.approx(0.03, abs=0.006)


def test_nothing_is_estimated_from_nothing(motion):
    config = TrackerConfig(synchronise=True, align_cameras=True)
    result = Tracker(motion.rig, motion.person, config).track(detect(motion, hidden=1.0))
    assert np.allclose(result.config["estimated"]["lag_s"], 0, atol=1e-9)
    assert np.isfinite(result.joints_head).all()
    one = detect(motion)
    few = {n: getattr(one, n)[:1] for n in ("times", "points", "sigma", "confidence", "valid")}
    short = Tracker(motion.rig, motion.person, config).track(replace(one, **few))
    assert np.isfinite(short.joints_head).all()
