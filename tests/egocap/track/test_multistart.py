"""Limbs get out of wrong poses, and only where that fits the detections better."""

import numpy as np
import pytest

from egocap.body.labels import LABEL_INDEX
from egocap.body.skeleton import DOF_COUNT, DOF_INDEX, forward
from egocap.pose import kernel
from egocap.pose.config import TrackerConfig
from egocap.pose.observations import observe
from egocap.track.multistart import LIMBS, changed_frames, merge_segments, solve_multistart
from egocap.track.smoother import interval_system, smooth_interval
from egocap.track.tracker import Tracker

CONFIG = TrackerConfig(acceleration_sigma=1.0)
"""So stiff that the arm stays where it is stuck without other starts."""
WRIST = LABEL_INDEX["left_wrist"]
ARM = LIMBS[1]


def test_limbs_and_trunk_share_the_angles_among_them():
    assert LIMBS[0].all()
    assert (np.sum(LIMBS[1:], axis=0) == 1).all()
    assert ARM[DOF_INDEX["left_elbow_flexion"]] and not ARM[DOF_INDEX["right_elbow_flexion"]]
    assert LIMBS[5].sum() == DOF_COUNT - sum(limb.sum() for limb in LIMBS[1:5])


@pytest.fixture
def known(motion):
    """From frame 20 on one view alone sees the left wrist, but for a moment, and none the hand."""
    seen = observe(motion.detect("simulated:2"), motion.rig, motion.person, CONFIG)
    elbow, hand = (LABEL_INDEX[f"left_{part}"] for part in ("elbow", "hand"))
    seen.weights[20:, :, [elbow, hand]] = 0.0
    seen.weights[20:60, 1, WRIST] = seen.weights[72:, 1, WRIST] = 0.0
    return seen, kernel.make_model(motion.person, CONFIG), CONFIG


@pytest.fixture
def stuck(motion, known):
    """The arm on the wrong side of the ray, past frames that both views see."""
    wrong = motion.angles.copy()
    for name, degrees in (
        ("shoulder_raise", 120), ("shoulder_swing", 40), ("shoulder_rotation", -60),
        ("elbow_flexion", 140),
    ):  # fmt: skip
        wrong[20:, DOF_INDEX[f"left_{name}"]] = np.deg2rad(degrees)
    return smooth_interval(wrong, *known)[0]


def wrist_error(motion, angles):
    return np.linalg.norm((forward(motion.person, angles) - motion.joints)[:, WRIST], axis=-1)


def test_an_arm_gets_out_of_a_wrong_pose(motion, known, stuck):
    assert wrist_error(motion, stuck)[30:].mean() > 0.1
    found, others = solve_multistart(stuck, *known)
    # From frame 72 on, one view of the wrist alone leaves the side to the posture prior.
    assert wrist_error(motion, found)[30:72].mean() < 0.015
    assert others[60:72].all()
    assert interval_system(found, *known)[0] < interval_system(stuck, *known)[0]


def test_what_is_right_stays_as_it_is(motion, known):
    angles, _ = smooth_interval(motion.angles, *known)
    found, others = solve_multistart(angles, *known)
    assert not others.any()
    np.testing.assert_allclose(found, angles, atol=0.01)


def test_only_the_limb_that_is_better_is_taken(motion, known):
    right, _ = smooth_interval(motion.angles, *known)
    bent, kicked, leg = right.copy(), right.copy(), LIMBS[4]
    bent[5:15, ARM] += 0.5
    kicked[:, leg] += 0.6
    best = merge_segments(bent, kicked, *known)
    np.testing.assert_array_equal(best, right)


def test_nothing_is_taken_from_a_worse_motion(motion, known):
    right, _ = smooth_interval(motion.angles, *known)
    worse = right + np.random.default_rng(0).normal(0, 0.3, right.shape)
    np.testing.assert_array_equal(merge_segments(right, worse, *known), right)


def test_motions_differ_where_an_angle_does():
    angles = np.zeros((5, DOF_COUNT))
    other = angles.copy()
    other[2, 7], other[4, 3] = 0.1, 1e-4
    assert changed_frames(angles, other).tolist() == [False, False, True, False, False]


def test_config_holds_number_of_multistart_frames(motion):
    found = motion.detect("simulated:2")
    assert (
        Tracker(motion.rig, motion.person).track(found).config["estimated"]["multistart_frames"]
        == 0
    )
    without = Tracker(motion.rig, motion.person, TrackerConfig(multistart=False)).track(found)
    assert "multistart_frames" not in without.config["estimated"]
