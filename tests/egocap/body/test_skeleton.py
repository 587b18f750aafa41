"""The skeleton against scipy's rotations, finite differences, mirrors and anatomy."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from egocap.body.labels import LABEL_INDEX, LABELS, MIRROR
from egocap.body.proportions import Proportions
from egocap.body.skeleton import (
    AGILITY,
    AXES,
    DOF_INDEX,
    DOFS,
    JOINTS,
    LABEL_POINTS,
    LIMITS,
    MIRROR_DOFS,
    MIRROR_SIGNS,
    POINT_INDEX,
    POINT_PARENTS,
    POINTS,
    SPREAD,
    forward,
    jacobian,
    points,
)

PERSON = Proportions.from_lengths(1.75)


def random_pose(seed, *shape):
    return np.random.default_rng(seed).normal(size=(*shape, 37)) * 0.5


def posed(**degrees):
    angles = np.zeros(37)
    for name, value in degrees.items():
        angles[DOF_INDEX[name]] = np.deg2rad(value)
    joints = forward(PERSON, angles)
    return {label: joints[i] for i, label in enumerate(LABELS)}


def test_counts_of_the_paper():
    assert len(JOINTS) == 17
    assert len(DOFS) == len(set(DOFS)) == 37
    counts = {j.name: len(j.dofs) for j in JOINTS}
    assert counts["neck"] == counts["upper_spine"] == counts["lower_spine"] == 3
    for side in ("left_", "right_"):
        expected = {"clavicle": 2, "shoulder": 3, "elbow": 1, "wrist": 2}
        expected |= {"hip": 3, "knee": 1, "ankle": 2}
        assert {k: counts[side + k] for k in expected} == expected


def test_parents_come_first_and_hang_from_the_skull():
    assert all(parent < i for i, parent in enumerate(POINT_PARENTS))
    assert [POINTS[i] for i, p in enumerate(POINT_PARENTS) if p < 0] == ["neck", "head"]
    assert LABEL_POINTS[LABEL_INDEX["neck"]] == POINT_INDEX["upper_spine"]


def test_tables_are_sound():
    assert np.allclose(np.linalg.norm(AXES, axis=1), 1)
    assert (LIMITS[:, 0] < 0).all() and (LIMITS[:, 1] > 0).all()  # rest is within
    assert (SPREAD > 0).all() and (AGILITY > 0).all()
    assert all(j.source for j in JOINTS)


def test_rest_pose_hangs_straight_down():
    joints = posed()
    for side in ("left", "right"):
        for chain in (("shoulder", "elbow", "wrist", "hand"), ("hip", "knee", "ankle")):
            rows = np.array([joints[f"{side}_{name}"] for name in chain])
            assert np.allclose(rows[:, :2], rows[0, :2])
            assert (np.diff(rows[:, 2]) < 0).all()
    assert joints["left_shoulder"][1] > 0 > joints["right_shoulder"][1]


def test_product_of_exponentials_against_scipy():
    angles = random_pose(1)
    frames = {-1: (np.eye(3), np.zeros(3))}
    expected = np.zeros((len(POINTS), 3))
    for i, parent in enumerate(POINT_PARENTS):
        R, origin = frames[parent]
        expected[i] = origin + R @ PERSON.offsets[i]
        if i < len(JOINTS):
            for dof in JOINTS[i].dofs:
                axis = np.array(dof.axis) / np.linalg.norm(dof.axis)
                R = R @ Rotation.from_rotvec(axis * angles[DOF_INDEX[dof.name]]).as_matrix()
            frames[i] = (R, expected[i])
    assert np.allclose(points(PERSON, angles), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("dof", "label", "axis", "sign"),
    [
        ("left_shoulder_raise", "left_hand", 0, 1),
        ("left_shoulder_raise", "left_hand", 1, 1),
        ("left_elbow_flexion", "left_hand", 0, 1),
        ("left_hip_flexion", "left_knee", 0, 1),
        ("left_hip_abduction", "left_knee", 1, 1),
        ("left_knee_flexion", "left_ankle", 0, -1),
        ("left_ankle_flexion", "left_foot", 2, 1),
        ("left_ankle_inversion", "left_foot", 1, -1),
        ("left_clavicle_elevation", "left_shoulder", 2, 1),
        ("left_clavicle_protraction", "left_shoulder", 0, 1),
        ("neck_flexion", "left_hip", 0, 1),  # head down: the body below it comes forward
        ("lower_spine_lean", "left_hip", 1, 1),
    ],
)
def test_signs_of_angles(dof, label, axis, sign):
    moved = posed(**{dof: 20})[label] - posed()[label]
    assert sign * moved[axis] > 0.01


def test_level_arm_points_where_the_plane_of_the_scapula_says():
    arm = posed(left_shoulder_raise=90)["left_elbow"] - posed()["left_shoulder"]
    assert np.allclose(arm / np.linalg.norm(arm), [np.sqrt(0.5), np.sqrt(0.5), 0], atol=1e-9)


@pytest.mark.parametrize(
    ("raise_", "swing"), [(0, 0), (90, -45), (90, 45), (180, 0)], ids=["hang", "fwd", "side", "up"]
)
def test_shoulder_is_regular_where_arms_often_are(raise_, swing):
    angles = np.zeros(37)
    angles[DOF_INDEX["left_shoulder_raise"]] = np.deg2rad(raise_)
    angles[DOF_INDEX["left_shoulder_swing"]] = np.deg2rad(swing)
    angles[DOF_INDEX["left_elbow_flexion"]] = np.pi / 2
    first = DOF_INDEX["left_shoulder_raise"]
    J = jacobian(PERSON, angles)[1][:, :, first : first + 3].reshape(-1, 3)
    assert np.linalg.cond(J) < 6


def test_jacobian_against_central_differences():
    angles = random_pose(2, 3)
    joints, J = jacobian(PERSON, angles)
    assert np.allclose(joints, forward(PERSON, angles))
    h = 1e-6
    for d in range(37):
        step = h * np.eye(37)[d]
        numeric = (forward(PERSON, angles + step) - forward(PERSON, angles - step)) / (2 * h)
        assert np.allclose(J[..., d], numeric, atol=1e-8)


def test_any_batch_gives_the_same():
    angles = random_pose(3, 4, 2)
    whole = forward(PERSON, angles)
    assert whole.shape == (4, 2, 18, 3)
    assert np.array_equal(whole[2, 1], forward(PERSON, angles[2, 1]))


def test_mirrored_pose_of_mirrored_person_is_the_mirror_image():
    offsets = PERSON.offsets + 0.01 * np.random.default_rng(4).normal(size=(22, 3))
    person, angles = Proportions(offsets), random_pose(5)
    mirrored = forward(person.mirrored, angles[list(MIRROR_DOFS)] * MIRROR_SIGNS)
    assert np.allclose(mirrored[list(MIRROR)] * [1, -1, 1], forward(person, angles), atol=1e-12)


def test_bones_keep_their_lengths_in_every_pose():
    moved = points(PERSON, random_pose(6, 10))
    for i, parent in enumerate(POINT_PARENTS):
        origin = moved[:, parent] if parent >= 0 else 0.0
        lengths = np.linalg.norm(moved[:, i] - origin, axis=-1)
        assert np.allclose(lengths, np.linalg.norm(PERSON.offsets[i]))
