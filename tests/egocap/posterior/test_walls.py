"""The Gaussian between walls has the moments of what it stands for."""

import numpy as np
import pytest

from egocap.posterior.walls import between_walls


def log_density(x, mean, precision, limits, weight):
    away = x - mean
    beyond = np.maximum(x - limits[:, 1], 0.0) + np.maximum(limits[:, 0] - x, 0.0)
    return -0.5 * np.einsum("...i,ij,...j->...", away, precision, away) - weight * np.sum(
        beyond**2, axis=-1
    )


def derivatives(x, mean, precision, limits, weight):
    over, under = x > limits[:, 1], x < limits[:, 0]
    edge = np.clip(x, limits[:, 0], limits[:, 1])
    return -precision @ (x - mean) - 2.0 * weight * (x - edge), precision + 2.0 * weight * np.diag(
        over | under
    )


@pytest.mark.parametrize("behind", [-1.0, 0.0, 0.5, 3.0])
def test_one_wall_has_the_moments_of_quadrature(behind):
    """Exact in one dimension, from inside the wall to far behind it."""
    limits, weight, precision = np.array([[-5.0, 0.0]]), 200.0, np.array([[1.0 / 0.3**2]])
    mean = np.array([0.3 * behind])
    x = np.linspace(-3.0, 3.0, 200_001)[:, None]
    p = np.exp(log_density(x, mean, precision, limits, weight))
    expected = (p @ x) / p.sum()
    spread = np.sqrt(p @ (x[:, 0] - expected) ** 2 / p.sum())
    for start in (-0.4, 0.02):  # the smooth part is the same wherever it is expanded
        theta = np.array([start])
        found, covariance = between_walls(
            theta, *derivatives(theta, mean, precision, limits, weight), limits, weight
        )
        assert found == pytest.approx(expected, abs=2e-3 * spread)
        assert covariance[0, 0] == pytest.approx(spread**2, rel=2e-3)


def test_bound_pair_and_a_free_parameter_come_close_to_sampling():
    rng = np.random.default_rng(0)
    root = np.array([[0.5, 0.0, 0.0], [0.35, 0.3, 0.0], [0.2, -0.2, 0.4]])
    precision = np.linalg.inv(root @ root.T)
    mean = np.array([0.2, -0.3, 0.1])
    limits, weight = np.array([[-2.0, 0.0], [-0.4, 2.0]]), 200.0
    draws = mean + rng.standard_normal((400_000, 3)) @ root.T
    walls = log_density(draws[:, :2], np.zeros(2), np.zeros((2, 2)), limits, weight)
    share = np.exp(walls) / np.exp(walls).sum()
    expected = share @ draws
    covariance = (draws - expected).T @ (share[:, None] * (draws - expected))
    theta = np.array([0.05, -0.3, 0.3])
    g, H = np.zeros(3), precision.copy()
    g[:] = -precision @ (theta - mean)
    g[0] -= 2.0 * weight * 0.05
    H[0, 0] += 2.0 * weight
    found, got = between_walls(theta, g, H, limits, weight)
    np.testing.assert_allclose(found, expected, atol=0.05 * np.sqrt(np.diag(covariance)).min())
    np.testing.assert_allclose(np.sqrt(np.diag(got)), np.sqrt(np.diag(covariance)), rtol=0.08)
    assert np.diag(got)[0] > 5.0 / H[0, 0]  # the wall's own curvature is far too narrow


def test_far_from_any_wall_it_is_laplace():
    precision = np.diag([4.0, 9.0])
    limits = np.array([[-50.0, 50.0], [-50.0, 50.0]])
    theta = np.array([1.0, 2.0])
    found, covariance = between_walls(theta, np.zeros(2), precision, limits, 200.0)
    np.testing.assert_allclose(found, theta, atol=1e-9)
    np.testing.assert_allclose(covariance, np.linalg.inv(precision), atol=1e-9)
