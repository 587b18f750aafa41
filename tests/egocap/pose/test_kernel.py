"""The compiled kernels against the readable energy and finite differences."""

import numpy as np
import pytest

from egocap.body.skeleton import AGILITY, SPREAD, jacobian, points
from egocap.pose import energy, kernel
from egocap.pose.config import TrackerConfig
from egocap.pose.motion_prior import NO_MOTION_PREDICTION, MotionPrediction
from egocap.pose.observations import Rays, observe
from egocap.track import smoother

CONFIG = TrackerConfig(lambda_pose=0.3, lambda_posture=0.2)
STEP = 1e-6


@pytest.fixture(scope="module")
def frame(motion):
    """Model, data of one frame and a pose beside the truth, beyond some limits."""
    seen = observe(motion.detect("simulated:2", hidden=0.2), motion.rig, motion.person, CONFIG)
    model = kernel.make_model(motion.person, CONFIG)
    pose = motion.angles[7] + 0.6 * np.random.default_rng(1).normal(size=37)
    return model, seen.frame(7), pose


def evaluate(term, pose):
    H, g = np.zeros((37, 37)), np.zeros(37)
    return term(pose, H, g), H, g


def gradient(function, pose):
    steps = STEP * np.eye(len(pose))
    return np.array([(function(pose + s) - function(pose - s)) / (2 * STEP) for s in steps])


def test_detection_term(motion, frame):
    model, data, pose = frame
    value, H, g = evaluate(lambda p, H, g: kernel.detections(model, p, data, 4.0, H, g), pose)

    def readable(p):
        return energy.detection_energy(motion.person, p, data, 4.0)

    assert value == pytest.approx(readable(pose), rel=1e-12)
    assert np.allclose(g, gradient(readable, pose), rtol=1e-5, atol=1e-4)
    assert np.array_equal(H, np.tril(H))


@pytest.mark.parametrize("away", [0.3, 0.0, 1e-9])
def test_a_joint_behind_or_in_a_camera_costs_most_and_pulls_nowhere(motion, frame, away):
    """The solver once drew joints through a lens, where the loss was 0 and its slope unbounded."""
    model, data, pose = frame
    joint = jacobian(motion.person, pose)[0][9]
    ray = data.rays[0, 9]
    weights = np.zeros_like(data.weights)
    weights[0, 9] = 0.7
    opposite = data._replace(centres=data.centres.copy(), weights=weights)
    opposite.centres[0] = joint + away * ray
    value, H, g = evaluate(lambda p, H, g: kernel.detections(model, p, opposite, 4.0, H, g), pose)
    assert value == pytest.approx(0.5 * 0.7 * 4.0**2)
    assert value == pytest.approx(energy.detection_energy(motion.person, pose, opposite, 4.0))
    assert not H.any()
    assert not g.any()


def test_detection_matrix_is_reweighted_gauss_newton(motion, frame):
    model, data, pose = frame
    centres, rays, whiten, weights = data
    _, H, _ = evaluate(lambda p, H, g: kernel.detections(model, p, data, 4.0, H, g), pose)
    joints, J = jacobian(motion.person, pose)
    expected = np.zeros((37, 37))
    for v in range(len(centres)):
        for label in np.flatnonzero(weights[v]):

            def residual(x, v=v, label=label):
                return energy.angular_residual(x, centres[v], rays[v, label], whiten[v, label])

            B = gradient(residual, joints[label]).T @ J[label]
            squared = np.sum(residual(joints[label]) ** 2)
            expected += weights[v, label] * (16 / (squared + 16)) ** 2 * B.T @ B
    assert np.allclose(H, np.tril(expected), rtol=1e-4, atol=1e-4 * np.abs(H).max())


def test_priors(frame):
    model, _, pose = frame
    value, H, g = evaluate(lambda p, H, g: kernel.priors(model, p, H, g), pose)

    def readable(p):
        return (
            energy.limit_energy(p, CONFIG.lambda_limit)
            + energy.pose_energy(p, CONFIG.lambda_pose)
            + energy.posture_energy(p, kernel.load_posture(), CONFIG.lambda_posture)
        )

    assert energy.limit_energy(pose, 1.0) > 0
    assert value == pytest.approx(readable(pose), rel=1e-12)
    assert np.allclose(g, gradient(readable, pose), rtol=1e-5, atol=1e-5)
    assert np.linalg.eigvalsh(H + np.tril(H, -1).T).min() > 0


def test_smoothness(motion, frame):
    model, _, pose = frame
    scatter, predicted = 0.2 * SPREAD, motion.angles[6]
    value, _, g = evaluate(
        lambda p, H, g: kernel.smoothness(model, p, predicted, scatter, H, g), pose
    )

    def readable(p):
        return energy.smoothness_energy(p, predicted, scatter, CONFIG.lambda_smooth)

    assert value == pytest.approx(readable(pose), rel=1e-12)
    assert np.allclose(g, gradient(readable, pose), rtol=1e-5, atol=1e-5)


def test_squared_residuals(motion, frame):
    model, data, pose = frame
    squared = np.zeros((2, 18))
    kernel.squared_residuals(model, pose, data, squared)
    joints = points(motion.person, pose)[model.label_points]
    expected = energy.angular_residual(joints, data[0][:, None], data[1], data[2])
    there = data[3] > 0
    assert np.allclose(squared[there], np.sum(expected**2, -1)[there])
    assert np.isinf(squared[~there]).all()


def test_window_of_frames(motion):
    """The banded system of the interval smoother, term by term and as a dense matrix."""
    frames = 5
    seen = observe(motion.detect("simulated:2"), motion.rig, motion.person, CONFIG)
    model = kernel.make_model(motion.person, CONFIG)
    poses = motion.angles[:frames] + 0.1 * np.random.default_rng(2).normal(size=(frames, 37))
    stencil = energy.acceleration_stencil(np.array([0, 0.03, 0.07, 0.1, 0.2]))
    bands, g = np.zeros((75, frames * 37), order="F"), np.zeros(frames * 37)
    halves = np.random.default_rng(3).normal(size=(frames, 37, 37))
    guide = MotionPrediction(motion.angles[:frames], halves @ np.swapaxes(halves, 1, 2))
    value = smoother.assemble(
        model, poses, seen.arrays, CONFIG.robust_scale, stencil, AGILITY, guide.mean,
        guide.precision, bands, g,
    )  # fmt: skip

    def readable(flat):
        sequence = flat.reshape(frames, 37)
        alone = sum(
            energy.frame_energy(
                motion.person,
                p,
                seen.frame(t),
                CONFIG,
            )
            for t, p in enumerate(sequence)
        )
        away = sequence - guide.mean
        squared = np.einsum("ti,tij,tj->t", away, guide.precision, away)
        guided = np.sum(0.5 * 37 * np.log1p(squared / 37))
        return alone + guided + energy.acceleration_energy(sequence, stencil, AGILITY)

    assert value == pytest.approx(readable(poses.ravel()), rel=1e-12)
    some = np.arange(0, frames * 37, 5)
    for i in some:
        step = STEP * (np.arange(frames * 37) == i)
        numeric = (readable(poses.ravel() + step) - readable(poses.ravel() - step)) / (2 * STEP)
        assert g[i] == pytest.approx(numeric, rel=1e-4, abs=1e-3)


def test_bands_hold_the_second_differences():
    """With nothing seen and no priors the bands are D^T W D, and W is one at rest."""
    config = TrackerConfig(lambda_pose=0, lambda_posture=0)
    from egocap.body.proportions import Proportions

    model = kernel.make_model(Proportions.from_lengths(1.7), config)
    frames = 6
    stencil = energy.acceleration_stencil(np.arange(frames) / 30)
    nothing = Rays(
        np.zeros((1, 3)), np.zeros((frames, 1, 18, 3)), np.zeros((frames, 1, 18, 2, 3)),
        np.zeros((frames, 1, 18)),
    )  # fmt: skip
    bands, g = np.zeros((75, frames * 37), order="F"), np.zeros(frames * 37)
    smoother.assemble(
        model, np.zeros((frames, 37)), nothing, 4.0, stencil, AGILITY,
        NO_MOTION_PREDICTION.mean, NO_MOTION_PREDICTION.precision, bands, g,
    )  # fmt: skip
    D = np.zeros((frames - 2, frames))
    for t in range(frames - 2):
        D[t, t : t + 3] = stencil[t]
    dense = np.kron(D.T @ D, np.diag(AGILITY**-2.0))
    for k in range(75):
        assert np.allclose(bands[k, : frames * 37 - k], np.diag(dense, -k))
