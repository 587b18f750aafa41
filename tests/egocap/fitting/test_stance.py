"""Stances and moves in footage, and what they weigh; how a body stands to its head."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from egocap.body.skeleton import DOF_COUNT, DOF_INDEX, forward
from egocap.errors import InputError
from egocap.fitting.body_prior import BodyPrior, to_proportions
from egocap.fitting.stance import MOVE_WEIGHT, WEIGHTS, neutral_weights, stance


def standing(**degrees):
    """Frames of a second of the rest pose, then of each set of angles, with rest between."""
    angles = np.zeros((20 + 40 * len(degrees), DOF_COUNT))
    for k, values in enumerate(degrees.values()):
        for dof, value in values.items():
            angles[20 + 40 * k : 40 + 40 * k, DOF_INDEX[dof]] = np.deg2rad(value)
    return angles


def weights_of(angles, neutral=(0.0, 0.5)):
    person = to_proportions(BodyPrior.for_height(1.75).mean)
    times, used = np.arange(len(angles)) / 20.0, np.full(len(angles), 30)
    return neutral_weights(times, used, forward(person, angles), neutral)


def seconds_of(weights):
    """Weights in each second of 20 frames."""
    return weights.reshape(-1, 20, 4).sum(1)


def test_returns_to_the_neutral_stance_are_found():
    """Stances of a second before and after a turn of the head; a passing one does not count."""
    angles = standing(left={"neck_turn": 40.0}, right={"neck_turn": -40.0})
    weights = seconds_of(weights_of(angles))
    assert weights[::2].tolist() == pytest.approx(np.ones((3, 4)))
    turn = [0.0, MOVE_WEIGHT, MOVE_WEIGHT, 0.0]
    assert weights[1::2].tolist() == pytest.approx(np.tile(turn, (2, 1)))
    passing = np.delete(angles, np.arange(43, 59), axis=0)
    assert weights_of(passing)[:, 0].sum() == pytest.approx(2.0)
    assert not weights_of(angles, None).any()


def test_one_stance_however_long_counts_once():
    assert weights_of(np.zeros((200, DOF_COUNT)))[:, 0].sum() == pytest.approx(1.0)


def test_no_detections_in_the_stance_are_refused():
    with pytest.raises(InputError, match="from 90 to 91 s"):
        weights_of(standing(), (90, 91))


def test_a_stance_is_told_by_head_and_body_whatever_the_neck_takes_of_it():
    """Neck and spine against each other: a stance; a turn of the spine or a squat: none."""
    shared = {"neck_lean": 15.0, "upper_spine_lean": -15.0}
    squat = {f"{side}_{joint}_flexion": 60.0 for side in ("left", "right")
             for joint in ("hip", "knee", "ankle")}  # fmt: skip
    for name, moved, count in (
        ("turn", {"upper_spine_turn": 20.0}, 2.0), ("squat", squat, 2.0), ("shared", shared, 1.0),
    ):  # fmt: skip
        weights = seconds_of(weights_of(standing(**{name: moved})))[:, 0]
        assert weights.sum() == pytest.approx(count), name
        assert weights[1] == 0.0, name


def test_the_balance_of_a_stick_is_that_of_its_segments():
    """Weights sum to nothing, so that the line does not depend on the origin; mass is up."""
    assert abs(WEIGHTS.sum()) < 1e-12
    joints = to_proportions(BodyPrior.for_height(1.75).mean).rest_joints
    line = WEIGHTS @ joints
    assert 0.85 < line[2] < 1.15  # Winter 2009: 0.55 of the stature above the floor
    assert abs(line[1]) < 1e-9 and abs(line[0]) < 0.06


def test_head_and_body_stand_to_each_other_as_they_are_turned():
    person = to_proportions(BodyPrior.for_height(1.75).mean)
    rest, _ = stance(forward(person, np.zeros((1, DOF_COUNT))))
    for axis, (row, sign) in enumerate([(1, -1.0), (0, 1.0), (2, -1.0)]):
        turn = Rotation.from_rotvec(0.1 * np.eye(3)[axis]).as_matrix()
        joints = forward(person, np.zeros((1, DOF_COUNT))) @ turn.T
        moved, _ = stance(joints)
        off = (np.arctan(moved) - np.arctan(rest))[0]
        assert off[row] == pytest.approx(0.1 * sign, abs=0.005), axis
