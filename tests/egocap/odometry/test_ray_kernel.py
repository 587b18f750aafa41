"""Residuals on rays: derivatives against finite differences, poses against known ones."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from egocap.odometry.ray_kernel import (
    OPPOSITE,
    exponential,
    logarithm,
    normal_equations,
    refine_pose,
    residual,
    sights_later,
    squared_residuals,
    tangents,
)


def scene(rng, count=60):
    """A pose, points around it at any angle, and their exact rays from two centres."""
    R = Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix()
    t = np.array([0.4, -1.2, 1.6])
    X = t + rng.normal(size=(count, 3)) * 2.0
    o = np.array([[0.3, 0.2, 0.1], [0.3, -0.2, 0.1]])[np.arange(count) % 2]
    d = (X - t) @ R - o
    return R, t, X, o, d / np.linalg.norm(d, axis=1, keepdims=True)


def error(R, t, X, o, b, inv_sigma=800.0):
    r, J_pose, J_point = np.empty(2), np.empty((2, 6)), np.empty((2, 3))
    ahead = residual(R, t, X, o, b, inv_sigma, r, J_pose, J_point)
    return r, J_pose, J_point, ahead


def test_tangents_are_orthonormal(rng):
    for b in rng.normal(size=(50, 3)):
        b /= np.linalg.norm(b)
        frame = np.vstack([*tangents(b), b])
        assert np.allclose(frame @ frame.T, np.eye(3), atol=1e-12)


def test_exponential_agrees_with_scipy(rng):
    for w in [np.zeros(3), np.full(3, 1e-6), *rng.normal(size=(5, 3))]:
        assert np.allclose(exponential(w), Rotation.from_rotvec(w).as_matrix(), atol=1e-12)


def test_derivatives_agree_with_differences(rng):
    R, t, X, o, b = scene(rng, 6)
    b = b + 0.01 * rng.normal(size=b.shape)
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    h = 1e-6
    for n in range(6):
        _, J_pose, J_point, _ = error(R, t, X[n], o[n], b[n])
        for i in range(6):
            step = h * np.eye(6)[i]
            ends = [error(R @ exponential(s * step[:3]), t + s * step[3:], X[n], o[n], b[n])[0]
                    for s in (1, -1)]  # fmt: skip
            assert (ends[0] - ends[1]) / (2 * h) == pytest.approx(J_pose[:, i], rel=1e-5, abs=1e-4)
        for i in range(3):
            step = h * np.eye(3)[i]
            ends = [error(R, t, X[n] + s * step, o[n], b[n])[0] for s in (1, -1)]
            assert (ends[0] - ends[1]) / (2 * h) == pytest.approx(J_point[:, i], rel=1e-5, abs=1e-4)


def test_residual_is_the_angle_in_standard_deviations(rng):
    R, t, X, o, b = scene(rng, 1)
    turned = np.cos(1e-3) * b[0] + np.sin(1e-3) * np.array(tangents(b[0])[0])
    r, *_ = error(R, t, X[0], o[0], turned, inv_sigma=1000.0)
    assert np.linalg.norm(r) == pytest.approx(1.0, rel=1e-5)


def test_a_point_behind_the_ray_is_an_outlier(rng):
    R, t, X, o, b = scene(rng, 1)
    r, J_pose, _, ahead = error(R, t, X[0], o[0], -b[0])
    assert not ahead
    assert (r == OPPOSITE).all()
    assert not J_pose.any()


def test_pose_is_found_among_outliers(rng):
    R, t, X, o, b = scene(rng, 120)
    b[::3] = rng.normal(size=b[::3].shape)
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    inv_sigma = np.full(len(X), 800.0)
    start = R @ exponential(np.array([0.02, -0.01, 0.015])), t + [0.03, -0.02, 0.01]
    widths = np.array([30.0, 12.0, 5.0, 3.0])
    found_R, found_t, H = refine_pose(*start, X, o, b, inv_sigma, widths, 10)
    assert found_R == pytest.approx(R, abs=1e-7)
    assert found_t == pytest.approx(t, abs=1e-7)
    inlier = squared_residuals(found_R, found_t, X, o, b, inv_sigma) < 1.0
    assert inlier.sum() >= 80
    expected, _, _ = normal_equations(R, t, X[inlier], o[inlier], b[inlier], inv_sigma[inlier], 1e6)
    assert pytest.approx(expected, rel=1e-3, abs=1e-2 * np.abs(expected).max()) == H


def test_covariance_is_that_of_the_errors(rng):
    """Normalised squared errors of repeated fits have the mean of chi-square with 6 degrees."""
    R, t, X, o, b = scene(rng, 100)
    inv_sigma = np.full(len(X), 800.0)
    squared = []
    for _ in range(150):
        noisy = b + rng.normal(size=b.shape) / 800.0
        noisy /= np.linalg.norm(noisy, axis=1, keepdims=True)
        found_R, found_t, H = refine_pose(R, t, X, o, noisy, inv_sigma, np.array([50.0]), 6)
        error = np.concatenate([Rotation.from_matrix(R.T @ found_R).as_rotvec(), found_t - t])
        squared.append(error @ H @ error)
    assert np.mean(squared) == pytest.approx(6.0, abs=4 * np.sqrt(12 / 150))


def test_logarithm_is_the_inverse_of_exponential(rng):
    for w in [np.zeros(3), np.full(3, 1e-7), *rng.normal(size=(5, 3)), np.array([0.0, 0.0, 3.1])]:
        np.testing.assert_allclose(logarithm(exponential(w)), w, atol=1e-9)


def test_sights_move_on_with_the_head(rng):
    centres, rays, twist = (rng.normal(size=(6, n)) for n in (3, 3, 6))
    delay = np.array([0.0, 1e-6, 0.01, -0.02, 0.3, 1.0])
    moved, turned = sights_later(centres, rays, delay, twist)
    R = Rotation.from_rotvec(delay[:, None] * twist[:, :3])
    np.testing.assert_allclose(moved, R.apply(centres) + delay[:, None] * twist[:, 3:], atol=1e-12)
    np.testing.assert_allclose(turned, R.apply(rays), atol=1e-12)
