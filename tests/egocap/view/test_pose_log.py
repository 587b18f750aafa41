import json
from dataclasses import replace

import numpy as np
import pytest

from egocap.errors import MachineError
from egocap.pose.config import TrackerConfig
from egocap.track.online import OnlineTracker
from egocap.view.live_run import LiveReport
from egocap.view.pose_log import pose_log
from tests.egocap.conftest import make_motion


def test_the_track_holds_every_pose(tmp_path):
    made = make_motion(frames=4)
    found = made.detect("simulated:2")
    tracker = OnlineTracker(made.rig, made.person, TrackerConfig(smoothing="fixed-lag"))
    poses = [tracker.step(found[t : t + 1]) for t in range(4)]
    with pose_log(tmp_path / "track.npz") as log:
        for pose in poses:
            log.append(replace(pose, time=pose.time + 5.0))
        track = log.track(made.person, "simulated", LiveReport(4, seconds=2.0))
    np.testing.assert_allclose(track.times, found.times - found.times[0])
    for name in ("angles", "joints_head", "covariance", "confidence", "converged"):
        np.testing.assert_array_equal(getattr(track, name), [getattr(p, name) for p in poses])
    assert track.seconds_per_frame == 0.5 and track.config["detections"] == "simulated"
    np.testing.assert_array_equal(track.offsets, made.person.offsets)
    json.dumps(track.config, allow_nan=False)


def test_a_log_leaves_no_file(tmp_path):
    person, out = make_motion(frames=2).person, tmp_path / "track.npz"
    with pose_log(out) as log, pytest.raises(MachineError, match="nothing to write"):
        log.track(person, "none", LiveReport())
    assert not list(tmp_path.iterdir())
