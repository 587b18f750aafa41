"""What the network is told: the same wherever a person stands and whichever way it faces."""

import numpy as np
import pytest

from egocap.data.head_pose import HeadPoses
from egocap.geometry import axis_angle, rigid
from egocap.pose.motion_features import GROUPS, head_features, pose_features, stature


@pytest.fixture
def heads(motion):
    t = motion.times
    turn = axis_angle(np.array([0.0, 0.0, 1.0]), 0.8 * np.sin(t))
    nod = axis_angle(np.array([0.0, 1.0, 0.0]), 0.3 * np.sin(3 * t))
    place = np.stack([1.2 * t, 0.1 * np.sin(5 * t), 1.6 + 0.03 * np.cos(9 * t)], -1)
    return HeadPoses(rigid(turn @ nod, place), np.ones(len(t), bool))


def features(motion, heads):
    return head_features(motion.times, motion.angles, motion.person, heads)


def test_place_and_heading_do_not_matter(motion, heads):
    elsewhere = rigid(axis_angle(np.array([0.0, 0.0, 1.0]), 2.0), np.array([3.0, -7.0, 40.0]))
    moved = HeadPoses(elsewhere @ heads.T_world_head, heads.known)
    assert np.allclose(features(motion, moved), features(motion, heads), atol=1e-9)


def test_tilt_matters(motion, heads):
    tilted = rigid(axis_angle(np.array([1.0, 0.0, 0.0]), 0.3), np.zeros(3))
    moved = HeadPoses(tilted @ heads.T_world_head, heads.known)
    assert np.abs(features(motion, moved) - features(motion, heads))[:, GROUPS[0]].max() > 0.3


def test_speeds_are_those_of_the_head(motion, heads):
    found = features(motion, heads)[5:-5]
    T = heads.T_world_head[5:-5]
    v = np.gradient(heads.T_world_head[:, :3, 3], motion.times, axis=0)[5:-5]
    ahead = T[:, :2, 0] / np.linalg.norm(T[:, :2, 0], axis=1, keepdims=True)
    forwards = np.sum(v[:, :2] * ahead, axis=1) / stature(motion.person)
    assert np.allclose(found[:, 6], 1.5 * forwards)
    nodding, turning = 0.9 * np.cos(3 * motion.times), 0.8 * np.cos(motion.times)
    pitch = 0.3 * np.sin(3 * motion.times)
    rates = np.stack([-turning * np.sin(pitch), nodding, turning * np.cos(pitch)], -1)[5:-5]
    assert np.allclose(found[:, 3:6], 0.7 * rates, atol=0.01)


def test_gaps_and_no_head_pose_are_zero(motion, heads):
    known = heads.known.copy()
    known[20:40] = False
    found = features(motion, HeadPoses(heads.T_world_head, known))
    assert not found[20:40].any() and found[:20].any(1).all()
    assert not features(motion, None).any()


def test_size_of_the_person_does_not_matter(motion):
    from egocap.body.proportions import Proportions

    std = np.full((len(motion.times), 18), 0.02)
    small = Proportions(0.9 * np.asarray(motion.person.offsets))
    assert np.allclose(pose_features(motion.angles, std, small),
                       pose_features(motion.angles, std, motion.person))  # fmt: skip
    assert stature(small) == pytest.approx(0.9 * stature(motion.person))
