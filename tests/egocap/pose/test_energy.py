"""Each energy term on its own: values with known answers."""

import numpy as np
import pytest

from egocap.body.skeleton import LIMITS, SPREAD
from egocap.geometry import axis_angle, unit
from egocap.pose import energy
from egocap.pose.observations import tangent_basis
from egocap.pose.pose_prior import load_posture

ZERO = np.zeros(37)


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


def test_prediction_of_equation_3():
    assert np.allclose(energy.predict(ZERO + 2, ZERO + 1, 0.25), 2.25)
    assert energy.smoothness_energy(ZERO + 2, ZERO + 2, SPREAD, 1.0) == 0


def test_constant_velocity_is_free_at_any_spacing():
    times = np.array([0, 0.03, 0.07, 0.08, 0.2, 0.21])
    steady = times[:, None] * np.ones(37) + 3
    stencil = energy.acceleration_stencil(times)
    assert energy.acceleration_energy(steady, stencil, SPREAD) == pytest.approx(0, abs=1e-12)
    assert (stencil[-2:] == 0).all()


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
