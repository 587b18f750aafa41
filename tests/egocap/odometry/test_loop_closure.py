"""Segments joined after a gap, and loops closed, on exact pictures of a box."""

import numpy as np
import pytest

from egocap.geometry import rigid
from egocap.odometry.config import OdometryConfig
from egocap.odometry.finish import finish
from egocap.odometry.loop_closure import close_loops, join_segments
from egocap.odometry.odometry import Odometry
from egocap.odometry.ray_kernel import exponential
from egocap.odometry.views import Views
from tests.egocap.odometry.box_world import BoxWorld, apart, small_rig, walk

RIG, WORLD = small_rig(), BoxWorld()
CONFIG = OdometryConfig(width=320, corners=150)
COVERED = range(20, 32)


def follow(pictures, frames, step_s=1 / 30):
    odometry = Odometry(Views.of(RIG, 320), CONFIG)
    for i in range(frames):
        odometry.add(i, i * step_s, pictures(i))
    return odometry


def covered(poses, after=WORLD):
    """Pictures of a walk whose lenses are covered for a while; another place may follow."""

    def pictures(i):
        if i in COVERED:
            return tuple(np.full((256, 320), 20, np.uint8) for _ in RIG.mounts)
        return (WORLD if i < COVERED.start else after).pictures(RIG, poses[i])

    return pictures


def test_segments_of_one_place_are_joined():
    poses = walk(56)
    pictures = covered(poses)
    odometry = follow(pictures, len(poses))
    assert {f.segment for f in odometry.map.frames} == {0, 1}
    assert join_segments(odometry, pictures) == 1
    result = finish(odometry.map, odometry.views)
    assert set(range(20)) | set(range(34, 56)) <= set(result.frame)
    distance, angle = apart(poses[result.frame], result.T_map_head)
    assert distance.max() < 0.005
    assert angle.max() < np.deg2rad(0.1)


def test_segments_of_different_places_stay_apart():
    poses = walk(56)
    pictures = covered(poses, BoxWorld(seed=5))
    odometry = follow(pictures, len(poses))
    assert join_segments(odometry, pictures) == 0
    assert {f.segment for f in odometry.map.frames} == {0, 1}


def test_a_loop_is_closed():
    """A head that looks around, and back to where it began, by half a turn either way."""
    yaw = np.deg2rad(170.0) * np.sin(np.linspace(0.0, np.pi, 40)) ** 2
    poses = walk(40, speed=0.4, turn=0.0)
    R = np.stack([exponential(np.array([0.0, 0.0, angle])) for angle in yaw])
    poses = rigid(R @ poses[:, :3, :3], poses[:, :3, 3])

    def pictures(i):
        return WORLD.pictures(RIG, poses[i])

    odometry = follow(pictures, len(poses), step_s=0.5)  # so slow that a visit is an earlier one
    before = [len(f.seen.point) for f in odometry.map.frames]
    assert close_loops(odometry, pictures) > 0
    assert sum(len(f.seen.point) for f in odometry.map.frames) > sum(before)
    result = finish(odometry.map, odometry.views)
    distance, angle = apart(poses[result.frame], result.T_map_head)
    assert distance.max() < 0.004
    assert angle.max() < np.deg2rad(0.1)


def test_nothing_is_joined_or_closed_in_a_short_walk():
    poses = walk(12)
    odometry = follow(lambda i: WORLD.pictures(RIG, poses[i]), len(poses))
    refuse = pytest.fail
    assert join_segments(odometry, lambda i: refuse("no picture is needed")) == 0
    assert close_loops(odometry, lambda i: refuse("no picture is needed")) == 0
