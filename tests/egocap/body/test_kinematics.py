"""The compiled kinematics against the readable one."""

import numpy as np
import pytest

from egocap.body.kinematics import (
    forward_kinematics,
    kinematic_tree,
    label_positions,
    pose_skeleton,
)
from egocap.body.proportions import Proportions
from egocap.body.skeleton import JOINTS, LIMITS, forward, points

PERSON = Proportions.from_lengths(1.68)


@pytest.mark.parametrize("seed", range(3))
def test_points_match_the_readable_form(seed):
    pose = np.random.default_rng(seed).uniform(*LIMITS.T)
    where, axes = pose_skeleton(kinematic_tree(PERSON), pose)
    assert np.allclose(where, points(PERSON, pose), atol=1e-12)
    assert np.allclose(np.linalg.norm(axes, axis=1), 1)


def test_outputs_may_hold_the_joints_alone():
    pose = np.random.default_rng(0).uniform(*LIMITS.T)
    joints, axes, R = np.empty((len(JOINTS), 3)), np.empty((37, 3)), np.empty((len(JOINTS), 3, 3))
    forward_kinematics(kinematic_tree(PERSON), pose, joints, axes, R)
    assert np.allclose(joints, points(PERSON, pose)[: len(JOINTS)], atol=1e-12)
    assert np.allclose(R @ np.swapaxes(R, -1, -2), np.eye(3), atol=1e-12)


def test_labels_of_several_poses():
    poses = np.random.default_rng(1).uniform(*LIMITS.T, (5, 37))
    assert np.allclose(label_positions(PERSON, poses), forward(PERSON, poses), atol=1e-12)
