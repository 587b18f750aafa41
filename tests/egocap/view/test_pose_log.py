import json
import resource
from dataclasses import replace

import numpy as np
import pytest

from egocap.pose.config import TrackerConfig
from egocap.track.online import OnlineTracker
from egocap.view.live_run import LiveReport
from egocap.view.pose_log import pose_log
from tests.egocap.conftest import make_motion


@pytest.fixture(scope="module")
def made():
    return make_motion(frames=4)


@pytest.fixture(scope="module")
def poses(made):
    found = made.detect("simulated:2")
    tracker = OnlineTracker(made.rig, made.person, TrackerConfig(smoothing="fixed-lag"))
    return [pose for t in range(4) for pose in tracker.step(found[t : t + 1])]


def test_the_track_holds_every_pose(tmp_path, made, poses):
    with pose_log(tmp_path / "track.npz") as log:
        for pose in poses:
            log.append(replace(pose, time=pose.time + 5.0))
        track = log.take(made.person, "simulated", LiveReport(4, seconds=2.0))
    times = [pose.time for pose in poses]
    np.testing.assert_allclose(track.times, np.subtract(times, times[0]))
    for name in ("angles", "joints_head", "covariance", "confidence", "converged"):
        np.testing.assert_array_equal(getattr(track, name), [getattr(p, name) for p in poses])
    assert track.seconds_per_frame == 0.5 and track.config["detections"] == "simulated"
    np.testing.assert_array_equal(track.offsets, made.person.offsets)
    json.dumps(track.config, allow_nan=False)
    assert not list(tmp_path.iterdir())


def test_poses_with_a_known_head_are_in_the_world(tmp_path, made, poses):
    T = np.eye(4)
    T[:3, 3] = 1.0, 2.0, 1.6
    with pose_log(tmp_path / "track.npz") as log:
        for i, pose in enumerate(poses):
            log.append(replace(pose, T_world_head=T if i == 2 else None))
        track = log.take(made.person, "simulated", LiveReport(4, seconds=2.0))
    assert track.in_world.tolist() == [False, False, True, False]
    np.testing.assert_allclose(track.joints_world, track.joints_head + T[:3, 3])


def test_a_full_disk_keeps_the_poses_before(tmp_path, made, poses):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (5000, limits[1]))  # cuts the third pose
    try:
        with pose_log(tmp_path / "track.npz") as log:
            log.append(poses[0])
            log.append(poses[1])
            with pytest.raises(OSError, match="too large"):
                log.append(poses[2])
            track = log.take(made.person, "simulated", LiveReport(2, seconds=1.0))
            assert log._file.tell() == 5000 and not log._file.seek(0, 2)  # its room is free
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    np.testing.assert_array_equal(track.angles, [pose.angles for pose in poses[:2]])
