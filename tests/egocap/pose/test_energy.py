"""Each energy term on its own: values with known answers."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from egocap.body.proportions import Proportions
from egocap.body.skeleton import LIMITS, SPREAD, forward
from egocap.geometry import axis_angle, unit
from egocap.pose import energy
from egocap.pose.config import TrackerConfig
from egocap.pose.observations import OPPOSITE, Rays, tangent_basis
from egocap.pose.pose_prior import load_posture

ZERO = np.zeros(37)
PERSON = Proportions.from_lengths(1.75)


def detections(rng):
    """Two views of any rays, each as sure in all directions across, and their deviations."""
    rays = unit(rng.normal(size=(2, 18, 3)))
    sigma = rng.uniform(0.05, 0.5, (2, 18))
    centres = np.array([[0.1, 0.15, 0.05], [0.1, -0.15, 0.05]])
    whiten = np.array([[tangent_basis(ray) for ray in view] for view in rays])
    whiten /= sigma[..., None, None]
    return Rays(centres, rays, whiten, rng.uniform(0.0, 1.0, (2, 18))), sigma


def disagreement(pose, seen, sigma, scale):
    """Detection energy from the angles between rays and joints, one detection at a time."""
    total = 0.0
    for v, centre in enumerate(seen.centres):
        for label, joint in enumerate(forward(PERSON, pose)):
            to_joint = (joint - centre) / np.linalg.norm(joint - centre)
            angle = np.arccos(np.clip(to_joint @ seen.rays[v, label], -1.0, 1.0))
            squared = (2.0 * np.tan(angle / 2) / sigma[v, label]) ** 2
            loss = 1.0 / (1.0 / squared + 1.0 / scale**2)
            total += 0.5 * seen.weights[v, label] * loss
    return total


@pytest.mark.parametrize("degrees", [0.1, 10, 90, 135, 175])
def test_residual_is_twice_the_tangent_of_half_the_angle(degrees):
    ray = unit(np.array([0.3, -0.5, 0.8]))
    joint = 2.5 * axis_angle(unit(np.cross(ray, [0, 0, 1.0])), np.deg2rad(degrees)) @ ray
    residual = energy.angular_residual(joint + 1, np.ones(3), ray, tangent_basis(ray))
    assert np.linalg.norm(residual) == pytest.approx(2 * np.tan(np.deg2rad(degrees) / 2))


def test_residual_behind_the_camera_stays_finite():
    ray = np.array([0.0, 0.0, 1.0])
    residual = energy.angular_residual(-ray, np.zeros(3), ray, tangent_basis(ray))
    assert np.isfinite(residual).all()


def test_residuals_of_many_joints_are_those_of_each():
    """Joints that have no direction, in the camera or opposite to the ray, are farthest alone."""
    rng = np.random.default_rng(0)
    rays = unit(rng.normal(size=(2, 4, 3)))
    joints = 1e-3 * rng.normal(size=(2, 4, 3))
    joints[0, 1], joints[1, 2] = 0.0, -rays[1, 2]
    whiten = np.array([[tangent_basis(ray) for ray in row] for row in rays])
    together = energy.angular_residual(joints, np.zeros(3), rays, whiten)
    alone = [[energy.angular_residual(joints[i, j], np.zeros(3), rays[i, j], whiten[i, j])
              for j in range(4)] for i in range(2)]  # fmt: skip
    np.testing.assert_allclose(together, alone)
    farthest = np.zeros((2, 4), bool)
    farthest[0, 1] = farthest[1, 2] = True
    np.testing.assert_array_equal((together == energy.FARTHEST).all(-1), farthest)


def test_joint_within_a_micrometre_of_the_camera_has_no_direction():
    ray = np.array([0.0, 0.0, 1.0])
    for distance, farthest in ((OPPOSITE, True), (1.001 * OPPOSITE, False)):
        joint = np.array([distance, 0.0, 0.0])
        residual = energy.angular_residual(joint, np.zeros(3), ray, tangent_basis(ray))
        assert (residual == energy.FARTHEST).all() == farthest


def test_detection_energy_follows_from_the_angles_to_the_rays():
    rng = np.random.default_rng(1)
    seen, sigma = detections(rng)
    pose = 0.3 * rng.normal(size=37)
    for scale in (0.5, 4.0):
        expected = disagreement(pose, seen, sigma, scale)
        assert energy.detection_energy(PERSON, pose, seen, scale) == pytest.approx(expected)


def test_robust_loss_is_quadratic_then_flat():
    assert energy.robust(np.array(1e-4), 4.0) == pytest.approx(1e-4, rel=1e-4)
    assert energy.robust(np.array(1e9), 4.0) == pytest.approx(16.0, rel=1e-4)


def test_pseudo_huber():
    assert energy.pseudo_huber(np.array(0.0)) == 0
    assert energy.pseudo_huber(np.array(np.sqrt(3))) == pytest.approx(1.0)


def test_limits_charge_only_what_is_beyond():
    assert energy.limit_energy(LIMITS[:, 1], 200.0) == 0
    assert energy.limit_energy(LIMITS[:, 0], 200.0) == 0
    assert energy.limit_energy(LIMITS[:, 1] + 0.1, 200.0) == pytest.approx(200 * 37 * 0.01)
    assert energy.limit_energy(LIMITS[:, 0] - 0.1, 200.0) == pytest.approx(200 * 37 * 0.01)


def test_pose_prior_rests_at_rest():
    assert energy.pose_energy(ZERO, 1.0) == 0
    assert energy.pose_energy(np.sqrt(3) * SPREAD, 1.0) == pytest.approx(37)


def test_posture_prior_rests_at_its_mean():
    posture = load_posture()
    assert energy.posture_energy(posture.mean, posture, 1.0) == 0
    assert energy.posture_energy(posture.mean + 0.1, posture, 1.0) > 0


def test_posture_prior_is_a_negative_log_density():
    """That of scipy's Gaussian, up to its value at the mean, times the weight."""
    posture = load_posture()
    gaussian = multivariate_normal(posture.mean, np.linalg.inv(posture.precision))
    pose = posture.mean + 0.1 * np.random.default_rng(2).normal(size=37)
    expected = gaussian.logpdf(posture.mean) - gaussian.logpdf(pose)
    assert energy.posture_energy(pose, posture, 1.0) == pytest.approx(expected)
    assert energy.posture_energy(pose, posture, 0.3) == pytest.approx(0.3 * expected)


def test_prediction_of_equation_3():
    assert np.allclose(energy.predict(ZERO + 2, ZERO + 1, 0.25), 2.25)
    assert np.allclose(energy.predict(ZERO + 5, ZERO + 1, 0.25), 6.0)
    assert energy.smoothness_energy(ZERO + 2, ZERO + 2, SPREAD, 1.0) == 0
    away = ZERO + 2 + np.sqrt(3) * SPREAD  # each angle costs 1
    assert energy.smoothness_energy(away, ZERO + 2, SPREAD, 0.1) == pytest.approx(3.7)


def test_constant_velocity_is_free_at_any_spacing():
    times = np.array([0, 0.03, 0.07, 0.08, 0.2, 0.21])
    steady = times[:, None] * np.ones(37) + 3
    stencil = energy.acceleration_stencil(times)
    assert energy.acceleration_energy(steady, stencil, SPREAD) == pytest.approx(0, abs=1e-12)
    assert (stencil[-2:] == 0).all()


def test_acceleration_costs_by_its_density():
    """A parabola of three even frames: the prior's energy is its acceleration squared times h."""
    h, density = 0.1, 0.2 + SPREAD
    times = np.array([0.0, h, 2 * h])
    faster = np.sqrt(3.0 / h) * density  # rad/s^2; sqrt(3) deviations, a cost of 1 an angle
    parabola = 0.5 * faster * times[:, None] ** 2
    stencil = energy.acceleration_stencil(times)
    assert energy.acceleration_energy(parabola, stencil, density) == pytest.approx(37)


@pytest.mark.parametrize("frames", [0, 1, 2])
def test_short_motions_have_no_acceleration(frames):
    assert (energy.acceleration_stencil(np.arange(frames) / 30) == 0).all()


def test_white_acceleration_has_unit_variance():
    """White acceleration of density 1, integrated finely, sampled at two rates."""
    rng = np.random.default_rng(0)
    fine = 1e-3
    velocity = np.cumsum(rng.standard_normal(400_000) * np.sqrt(fine))
    position = np.cumsum(velocity) * fine
    for every in (33, 100):
        samples = position[::every]
        stencil = energy.acceleration_stencil(np.arange(len(samples)) * every * fine)[:-2]
        scaled = sum(stencil[:, k] * samples[k : len(samples) - 2 + k] for k in range(3))
        # An integrated second difference of white noise has 2/3 of a point sample's variance.
        assert scaled.var() == pytest.approx(2 / 3, rel=0.12)


def test_energy_of_a_frame_is_that_of_its_detections_limits_and_priors():
    """Each term from its closed form; some angles are beyond their limits."""
    rng = np.random.default_rng(3)
    seen, sigma = detections(rng)
    config = TrackerConfig(robust_scale=3.0, lambda_limit=7.0, lambda_pose=0.2, lambda_posture=0.05)
    pose = LIMITS.mean(1)
    pose[[3, 20]] = LIMITS[[3, 20], 1] + 0.1
    pose[30] = LIMITS[30, 0] - 0.2
    posture = load_posture()
    gaussian = multivariate_normal(posture.mean, np.linalg.inv(posture.precision))
    expected = (
        disagreement(pose, seen, sigma, 3.0)
        + 7.0 * (2 * 0.01 + 0.04)
        + 0.2 * sum(np.hypot(1.0, x / s) - 1.0 for x, s in zip(pose, SPREAD, strict=True))
        + 0.05 * (gaussian.logpdf(posture.mean) - gaussian.logpdf(pose))
    )
    assert energy.frame_energy(PERSON, pose, seen, config) == pytest.approx(expected)
