"""Findings: what is out of the pictures, by which tilt it comes in, and which moments are worst."""

import json
from dataclasses import replace

import numpy as np
import pytest

from egocap.body.proportions import Proportions
from egocap.data.footage import Footage
from egocap.data.head_pose import HeadPoses, in_world
from egocap.geometry import axis_angle
from egocap.motion_capture.findings import (
    best_tilt,
    find,
    in_pictures,
    relative_size,
    residuals,
    worst_frames,
)
from egocap.track.tracker import Tracker
from egocap.track.view_agreement import check_agreement
from tests.egocap.conftest import make_motion


def tilted_up(rig, degrees):
    turn = axis_angle(np.array([0.0, 1.0, 0.0]), np.deg2rad(-degrees))
    mounts = []
    for mount in rig.mounts:
        T = mount.T_head_camera.copy()
        T[:3, :3] = turn @ T[:3, :3]
        mounts.append(replace(mount, T_head_camera=T))
    return replace(rig, mounts=tuple(mounts))


def test_cameras_that_look_too_high_are_told_how_far_to_tilt():
    made = make_motion(frames=30)
    high = tilted_up(made.rig, 60)
    assert high.cameras == made.rig.cameras
    tilt = best_tilt(high, made.joints)
    assert tilt.degrees >= 20 and tilt.in_view_tilted > tilt.in_view + 0.1
    assert abs(best_tilt(made.rig, made.joints).degrees) <= 5


def test_joints_behind_the_lens_are_in_no_picture():
    made = make_motion(frames=5)
    joints = np.concatenate([made.joints[:1], made.joints[:1] + [0.0, 0.0, 30.0]])
    inside = in_pictures(made.rig, joints)
    assert inside[0].mean() > 0.9 and inside[1].mean() < 0.5


def test_residuals_are_those_of_the_noise_and_grow_with_another_body():
    made = make_motion(frames=40)
    found = made.detect("simulated:2.0")
    right = Tracker(made.rig, made.person).track(found)
    assert all(0.7 < value < 1.5 for value in residuals(right, found, made.rig).values())
    assert relative_size(right, 1.75) == pytest.approx(1.0, abs=0.05)
    small = Tracker(made.rig, Proportions.from_lengths(1.3)).track(found)
    assert min(residuals(small, found, made.rig).values()) > 3.0
    assert relative_size(small, 1.75) < 0.8


def test_frames_without_a_place_are_told():
    made = make_motion(frames=30)
    found = made.detect("simulated:2.0")
    heads = HeadPoses(np.tile(np.eye(4), (30, 1, 1)), np.arange(30) < 15)
    track = in_world(Tracker(made.rig, made.person).track(found), heads)
    told = find(
        track, found, made.rig, Footage(views=(), report={}), check_agreement(found, made.rig)
    )
    assert told.in_world == 0.5
    assert any("known in 50 % of the frames" in line for line in told.advice)


@pytest.mark.parametrize("vertical, told", [
    ({"up_std_deg": 0.2, "floor_std_mm": 9.0}, None),
    ({"up_std_deg": 4.5, "floor_std_mm": 180.0}, "Up is uncertain by 4.5 degrees and the floor's "
                                                  "height by 180 mm"),
    ({"up_std_deg": 10.0, "floor_std_mm": None}, "up is uncertain by 10.0 degrees"),
])  # fmt: skip
def test_an_uncertain_world_is_told(vertical, told):
    made = make_motion(frames=10)
    found = made.detect("simulated:2.0")
    track = Tracker(made.rig, made.person).track(found)
    lines = find(track, found, made.rig, Footage(views=(), report={}),
                 check_agreement(found, made.rig), vertical=vertical).advice  # fmt: skip
    said = [line for line in lines if "uncertain" in line]
    assert len(said) == (told is not None) and all(told in line for line in said)


@pytest.mark.parametrize("views", [1, 2])
def test_a_wrong_body_is_told_where_views_cannot_be_compared(views):
    """One camera has nothing to compare; two share too few detections in two frames."""
    made = make_motion(frames=60 if views == 1 else 2)
    rig = replace(made.rig, mounts=made.rig.mounts[:views])
    one = replace(made, rig=rig).detect("simulated:2.0")
    track = Tracker(rig, Proportions.from_lengths(1.3)).track(one)
    told = find(track, one, rig, Footage(views=(), report={}), check_agreement(one, rig))
    assert "The body comes out 7" in told.advice[0]
    assert any("share too few" in line for line in told.advice) is (views == 2)


def test_what_is_not_known_is_null():
    made = make_motion(frames=12)
    found = made.detect("simulated:2.0")
    found.valid[:, 1] = False
    track = Tracker(made.rig, made.person).track(found)
    agreement = check_agreement(found, made.rig)
    told = find(track, found, made.rig, Footage(views=(), report={}), agreement).to_dict()
    assert json.loads(json.dumps(told, allow_nan=False))["residual"]["right"] is None


def test_worst_frames_are_apart():
    sure = np.ones(300)
    sure[[100, 101, 102, 250]] = [0.2, 0.1, 0.15, 0.5]
    found = worst_frames(sure, np.arange(300) / 30.0)
    assert {101, 250} <= set(found) and not {100, 102} & set(found)
    assert min(np.diff(found)) >= 30
