"""Measures of a motion in the world, on motions whose error is known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from egocap.body.labels import LABEL_INDEX
from egocap.data.truth import Truth
from egocap.evaluation.measures import measure
from egocap.evaluation.pose_errors import GroundTruth, PoseErrors, WorldPrediction
from egocap.evaluation.world_metrics import penetration
from egocap.geometry import inverse, rigid, transform

FRAMES = 120
HEELS = [LABEL_INDEX["left_ankle"], LABEL_INDEX["right_ankle"]]
TOES = [LABEL_INDEX["left_foot"], LABEL_INDEX["right_foot"]]


def walked(seed=0):
    """A person shifted along a curved way of 8 m, with standing feet, and the head's poses."""
    rng = np.random.default_rng(seed)
    times = np.arange(FRAMES) / 30
    body = 0.4 * rng.normal(size=(18, 3)) + [0.0, 0.0, 1.0]
    way = np.stack([2.0 * times, 0.3 * np.sin(times), 0.0 * times], -1)
    joints = body + way[:, None] + 0.02 * np.sin(times[:, None, None] + rng.normal(size=(18, 3)))
    contact = np.zeros((FRAMES, 4), bool)
    for k, joint in enumerate([HEELS[0], TOES[0], HEELS[1], TOES[1]]):
        joints[40:60, joint] = joints[40, joint]
        contact[40:60, k] = True
        joints[~contact[:, k], joint, 2] += 0.1
    turn = Rotation.from_euler("zyx", np.stack([0.2 * times, 0.1 * times, 0 * times], -1))
    T = rigid(turn.as_matrix(), way + [0.0, 0.0, 1.6])
    return times, joints, T, contact


def compared(world, known=None, contacts=None):
    times, joints, T, contact = walked()
    truth = GroundTruth(transform(inverse(T), joints), times, T_world_head=T, contact=contact)
    known = np.ones(FRAMES, bool) if known is None else known
    return PoseErrors.between(
        truth.joints_head, truth, world=WorldPrediction(world, known, contacts)
    )


def test_true_motion_in_another_world_scores_zero():
    _, joints, _, contact = walked()
    turn = Rotation.from_euler("z", 0.7).as_matrix()
    errors = compared(joints @ turn.T + [3.0, -2.0, 0.0], contacts=contact.astype(float))
    for name in ("world_mpjpe_mm", "world_aligned_mpjpe_mm", "root_translation_percent",
                 "world_accel_error", "foot_skate", "penetration_mm"):  # fmt: skip
        assert measure(errors, name) == pytest.approx(0.0, abs=1e-6), name
    assert measure(errors, "contact_f1") == 1.0


def test_drift_counts_from_the_first_frame_and_as_a_share_of_the_way():
    times, joints, _, _ = walked()
    drift = 0.05 * times[:, None] * [1.0, 0.0, 0.0]  # m/s, along the way
    errors = compared(joints + drift[:, None])
    mean = 1e3 * np.linalg.norm(drift, axis=1).mean()
    assert measure(errors, "world_mpjpe_mm") == pytest.approx(mean, rel=1e-6)
    assert measure(errors, "world_aligned_mpjpe_mm") < 0.6 * mean
    root = joints[:, [LABEL_INDEX["left_hip"], LABEL_INDEX["right_hip"]]].mean(1)
    way = np.linalg.norm(np.diff(root, axis=0), axis=1).sum()
    # Of a drift along the way, the alignment leaves the half on either side of the middle.
    expected = 100 * np.abs(drift[:, 0] - drift[:, 0].mean()).mean() / way
    assert measure(errors, "root_translation_percent") == pytest.approx(expected, rel=0.05)


def test_frames_without_head_pose_do_not_count():
    _, joints, _, contact = walked()
    world, known = joints.copy(), np.ones(FRAMES, bool)
    world[50:], known[50:] = 77.0, False
    errors = compared(world, known, contact.astype(float))
    assert measure(errors, "world_mpjpe_mm") == pytest.approx(0.0, abs=1e-6)
    assert measure(errors, "foot_skate") == pytest.approx(0.0, abs=1e-9)
    assert measure(errors, "contact_f1") == 1.0
    assert measure(compared(world, np.zeros(FRAMES, bool)), "world_mpjpe_mm") is None


def test_frames_that_were_not_predicted_leave_the_others_their_contacts():
    """They hold zeros, a metre below this floor, or below the head."""
    times, joints, T, contact = walked()
    high = joints + [0.0, 0.0, 1.0]
    missing = np.isin(np.arange(FRAMES), [42, 45])
    expected = pytest.approx(measure(compared(high), "contact_f1"), rel=0.03)
    gappy = np.where(missing[:, None, None], 0.0, high)
    assert measure(compared(gappy, ~missing), "contact_f1") == expected
    truth = GroundTruth(transform(inverse(T), joints), times, T_world_head=T, contact=contact)
    predicted = np.where(missing[:, None, None], 0.0, truth.joints_head)
    valid = np.broadcast_to(~missing[:, None], (FRAMES, 18))
    errors = PoseErrors.between(predicted, truth, valid=valid)
    assert measure(errors, "contact_f1") == expected
    assert measure(errors, "foot_skate") == pytest.approx(0.0, abs=1e-9)
    assert measure(errors, "penetration_mm") == pytest.approx(0.0, abs=1e-6)


def test_contacts_that_the_simulation_does_not_know_do_not_count():
    """A wearer on a ladder that is not there: a track may say that the feet stand."""
    times, joints, T, contact = walked()
    frames = len(times)
    stands = contact.astype(float)
    stands[:20] = 1.0  # on rungs
    falls = np.zeros((frames, 6))
    carried = np.where(contact.any(1)[:, None], [0.0, 0.0, 700.0], 0.0)
    hung = np.where(contact.any(1)[:, None], 0.0, [0.0, 0.0, 700.0, 0.0, 0.0, 0.0])
    for wrench, score in ((falls, 2 / 3), (hung, 1.0)):
        given = {"contact": contact, "ground_force": carried[:, None], "root_wrench": wrench}
        state = Truth(**dict.fromkeys(Truth.__annotations__) | given)
        truth = GroundTruth(
            transform(inverse(T), joints), times, T_world_head=T, contact=contact,
            propped=state.propped,
        )  # fmt: skip
        world = WorldPrediction(joints, np.ones(frames, bool), stands)
        errors = PoseErrors.between(truth.joints_head, truth, world=world)
        assert measure(errors, "contact_f1") == pytest.approx(score)


def test_without_a_world_of_its_own_there_is_no_drift():
    times, joints, T, contact = walked()
    truth = GroundTruth(transform(inverse(T), joints), times, T_world_head=T, contact=contact)
    errors = PoseErrors.between(truth.joints_head, truth)
    assert measure(errors, "world_mpjpe_mm") is None
    assert measure(errors, "root_translation_percent") is None
    assert measure(errors, "foot_skate") == pytest.approx(0.0, abs=1e-9)


def test_penetration_is_below_the_ground_stood_on_and_known_near_it_only():
    stood = np.array([[[0.0, 0.0, 0.03], [1.0, 0.0, 0.20]]])
    planted = np.ones((1, 2), bool)
    feet = np.array([[[0.1, 0.0, 0.01], [1.1, 0.0, 0.30], [5.0, 0.0, -9.0]]])
    np.testing.assert_allclose(penetration(feet, stood, planted), [0.02, 0.0])
    assert len(penetration(feet, stood, ~planted)) == 0


def test_sunken_feet_are_measured_after_alignment():
    _, joints, _, _ = walked()
    world = joints.copy()
    world[40:60, TOES[0], 2] -= 0.04
    found = measure(compared(world), "penetration_mm")
    # 20 of the frames sink by 40 mm; around the standing toes the ground is known.
    assert found is not None and 0.0 < found < 40.0
    assert found > 4 * measure(compared(joints + [0, 0, 0.5]), "penetration_mm")
