"""Derivatives of body and mount against differences; a planted mount."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from egocap.body.skeleton import DOF_COUNT, DOF_INDEX, forward
from egocap.errors import InputError
from egocap.fitting.body_prior import BodyPrior, to_proportions
from egocap.fitting.bundle_adjustment import linearised
from egocap.fitting.config import FitConfig
from egocap.fitting.fit_rig import SYSTEMATIC, MountError, fit_rig, moved_rig
from egocap.fitting.mount import MountPrior, MountProblem
from egocap.fitting.stance import WEIGHTS
from egocap.geometry import exponential, inverse, right_jacobian
from egocap.pose.config import TrackerConfig
from egocap.pose.observations import observe

SHIFT = np.array([0.04, -0.05, 0.03, 0.009, -0.008, 0.009])
STANDING = 15


@pytest.fixture(scope="module")
def seen(motion):
    """A person who stands in balance for half a second and then moves."""
    person = to_proportions(BodyPrior.for_height(1.75).mean)
    angles = motion.angles.copy()
    angles[:STANDING] = 0.0

    def lean(flexion):
        pose = angles[0].copy()
        pose[DOF_INDEX["lower_spine_flexion"]] = flexion
        return (WEIGHTS @ forward(person, pose))[0]

    stance = angles[0].copy()
    stance[DOF_INDEX["lower_spine_flexion"]] = brentq(lean, -0.3, 0.3)
    share = np.clip((np.arange(len(angles)) - STANDING) / 20.0, 0.0, 1.0)[:, None]
    angles = stance + share * (motion.angles - stance)
    return replace(motion, person=person, angles=angles, joints=forward(person, angles))


@pytest.fixture(scope="module")
def fit(seen):
    given = moved_rig(seen.rig, SHIFT)
    config = FitConfig(frames=40)
    return fit_rig(seen.detect("simulated:0.5"), given, 1.75, config=config), given


def test_the_right_jacobian_is_that_of_scipys_rotations():
    rng = np.random.default_rng(0)
    for size in (0.0, 1e-7, 0.3, 1.5):
        w, dw = size * rng.normal(size=3), 1e-6 * rng.normal(size=3)
        turned = Rotation.from_rotvec(w) * Rotation.from_rotvec(right_jacobian(w) @ dw)
        np.testing.assert_allclose(Rotation.from_rotvec(w + dw).as_matrix(), turned.as_matrix(),
                                   atol=1e-11)  # fmt: skip
        np.testing.assert_allclose(exponential(w), Rotation.from_rotvec(w).as_matrix(), atol=1e-12)


def problem_of(seen, neutral):
    body = BodyPrior.for_height(1.75)
    given = moved_rig(seen.rig, SHIFT)
    found = seen.detect("simulated:1.0")[: len(neutral)]
    observations = observe(found, given, seen.person, TrackerConfig())
    prior = MountPrior.around(body.mean, body.covariance, 0.1, 0.03)
    return MountProblem(observations, prior, TrackerConfig(), np.array(neutral))


def test_joints_are_those_of_the_given_rig(seen):
    problem = problem_of(seen, np.zeros((3, 4)))
    shared = problem.prior.mean + np.append(np.zeros(len(problem.prior.mean) - 6), -SHIFT)
    labels, _, by_shared = problem.joints(shared, seen.angles[:3])
    move = np.eye(4)
    move[:3, :3], move[:3, 3] = exponential(-SHIFT[:3]), -SHIFT[3:]
    there = inverse(move)
    joints = forward(seen.person, seen.angles[:3])
    np.testing.assert_allclose(labels, joints @ there[:3, :3].T + there[:3, 3], atol=1e-12)
    for k in range(len(shared)):
        step = 1e-6 * np.eye(len(shared))[k]
        up, down = (problem.joints(shared + s * step, seen.angles[:3]).labels for s in (1, -1))
        np.testing.assert_allclose(by_shared[..., k], (up - down) / 2e-6, atol=1e-7)


def test_the_gradient_is_that_of_differences(seen):
    problem = problem_of(seen, [[0.25, 0.3, 0.0, 0.1], [0.75, 0.1, 0.6, 0.0], [0.0] * 4])
    rng = np.random.default_rng(1)
    shared = problem.prior.mean + 0.01 * rng.normal(size=len(problem.prior.mean))
    poses = seen.angles[:3] + 0.05 * rng.normal(size=(3, DOF_COUNT))
    system = linearised(problem, poses, shared)
    slopes = [
        (linearised(problem, poses, shared + 1e-6 * e).energy
         - linearised(problem, poses, shared - 1e-6 * e).energy) / 2e-6
        for e in np.eye(len(shared))
    ]  # fmt: skip
    np.testing.assert_allclose(system.g_body, slopes, rtol=1e-4, atol=1e-3)
    for d in range(DOF_COUNT):
        step = np.zeros_like(poses)
        step[:, d] = 1e-6
        slope = (
            linearised(problem, poses + step, shared).energy
            - linearised(problem, poses - step, shared).energy
        ) / 2e-6
        assert system.g_pose[:, d].sum() == pytest.approx(slope, rel=1e-4, abs=1e-3)


def test_a_planted_shift_is_found(fit, seen):
    found, _ = fit
    D = found.rig.T_head_camera[0] @ inverse(seen.rig.T_head_camera[0])
    turn = Rotation.from_matrix(D[:3, :3]).as_rotvec(degrees=True)
    assert found.converged
    assert np.linalg.norm(D[:3, 3]) < 0.006
    assert np.linalg.norm(turn) < 2.5
    assert (np.abs(turn) / np.rad2deg(found.std[:3])).max() < 3.0


def test_all_cameras_move_together(fit):
    found, given = fit
    between = [inverse(r.T_head_camera[0]) @ r.T_head_camera[1] for r in (found.rig, given)]
    np.testing.assert_allclose(*between, atol=1e-12)
    np.testing.assert_allclose(moved_rig(given, found.shift).T_head_camera, found.rig.T_head_camera)


def test_without_a_neutral_stance_the_rotation_is_said_to_be_unknown(fit, seen):
    """The neck takes up any rotation: its standard deviation stays near the prior's."""
    _, given = fit
    found = fit_rig(seen.detect("simulated:0.5"), given, 1.75, None, config=FitConfig(frames=20))
    assert any("neutral stance" in note for note in found.notes())
    assert (found.std[:3] > 1.5 * fit[0].std[:3]).all()
    assert found.neutral == 0 and not found.observed[:3].all()
    assert set(found.report()) == {"roll", "pitch", "yaw", "forward", "left", "up"}


def test_the_accuracy_of_the_rotation_and_that_of_more_stances_are_stated(fit):
    """Two stances leave more than a degree; without the systematic part, six leave 1 / sqrt(3)."""
    found, _ = fit
    own = np.full(3, np.deg2rad(1.2) ** 2)
    covariance = np.diag(np.append(own, found.std[3:] ** 2)) + np.diag(SYSTEMATIC**2)
    notes = replace(found, covariance=covariance, stances=2).notes()
    assert len(notes) == 1 and "6 stances leave 1.5" in notes[0]
    assert f"{np.sqrt(3 * (1.2**2 + 0.5**2)):.1f} degrees" in notes[0]
    assert not replace(found, covariance=covariance / 9.0, stances=2).notes()


def test_impossible_requests_are_refused(seen):
    found = seen.detect("simulated:1.0")
    with pytest.raises(InputError, match="from 90 to 91 s"):
        fit_rig(found, seen.rig, neutral=(90, 91))
    with pytest.raises(InputError, match="no detection to fit"):
        fit_rig(replace(found, valid=np.zeros_like(found.valid)), seen.rig)
    with pytest.raises(InputError, match="mount error"):
        fit_rig(found, seen.rig, error=MountError(0.0, 1.0))
