"""Band matrices against the same as dense ones."""

import numpy as np
import pytest

from egocap.pose.banded import add_block, add_quadratic, banded_inverse, eliminate, solve_damped

N, K = 12, 5


def made(seed=0, size=N, width=K):
    """A positive definite band matrix, dense and as a band, and a right-hand side."""
    rng = np.random.default_rng(seed)
    factor = np.tril(np.triu(rng.normal(size=(size, size)), 1 - width))
    A = factor @ factor.T + np.eye(size)
    return A, band(A, width), rng.normal(size=size)


def band(A, width=K):
    bands = np.zeros((width, len(A)), order="F")
    for k in range(min(width, len(A))):
        bands[k, : len(A) - k] = np.diag(A, -k)
    return bands


@pytest.mark.parametrize("size", [N, 450])
def test_damped_solution_against_a_dense_one(size):
    A, bands, right = made(size=size)
    given = bands.copy(), right.copy()
    x = solve_damped(bands, right, 0.1)
    dense = np.linalg.solve(A + 0.1 * np.diag(np.diag(A)), right)
    np.testing.assert_allclose(x, dense, atol=1e-12)
    np.testing.assert_array_equal(bands, given[0])
    np.testing.assert_array_equal(right, given[1])


def test_elimination_leaves_the_schur_complement():
    A, bands, right = made(1)
    n, width = 4, K  # the rest of the band holds what the first unknowns leave
    first, rest = A[:n, :n], A[n:, n:] - A[n:, :n] @ np.linalg.solve(A[:n, :n], A[:n, n:])
    left = right[n:] - A[n:, :n] @ np.linalg.solve(first, right[:n])
    assert eliminate(bands, right, n)
    np.testing.assert_allclose(bands[:, n:], band(rest, width), atol=1e-12)
    np.testing.assert_allclose(right[n:], left)


@pytest.mark.parametrize("size", [N, 450])
def test_indefinite_matrices_are_reported(size):
    _, bands, right = made(size=size)
    bands[0, 7] = -1.0
    assert solve_damped(bands, right, 0.0) is None
    assert not eliminate(bands.copy(order="F"), right.copy(), size)
    with pytest.raises(np.linalg.LinAlgError):
        banded_inverse(bands, 1)


@pytest.mark.parametrize("size", [1, 2, 3, 4])
def test_blocks_of_the_inverse(size):
    A, bands, _ = made(2)
    inverse = np.linalg.inv(A)
    expected = [inverse[i : i + size, i : i + size] for i in range(0, N, size)]
    np.testing.assert_allclose(banded_inverse(bands, size), expected, atol=1e-12)


def test_one_block_alone():
    A, _, _ = made(3, 4)
    np.testing.assert_allclose(banded_inverse(band(A, 9), 4)[0], np.linalg.inv(A), atol=1e-12)


def test_added_terms():
    A, bands, gradient = made(4)
    inner, narrow, slope = made(5, 6)
    x = np.arange(6.0)
    H, g = made(6, 3, 3)[::2]
    expected, pull = A.copy(), gradient.copy()
    expected[:6, :6] += inner
    expected[2:5, 2:5] += H
    pull[:6] += inner @ x + slope
    pull[2:5] += g
    energy = add_quadratic(narrow, slope, x, bands, gradient)
    add_block(np.tril(H), g, 2, bands, gradient)
    assert energy == pytest.approx(0.5 * x @ inner @ x + slope @ x)
    np.testing.assert_allclose(bands, band(expected))
    np.testing.assert_allclose(gradient, pull)
