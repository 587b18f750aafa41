"""Symmetric positive definite band matrices, compiled: solution, elimination, inverse.

`bands[k, i]` is element (i + k, i), as LAPACK stores a lower band; in Fortran's order a column is
contiguous. The kernels release Python's global lock; scipy's wrappers of LAPACK hold it.

Source: Golub & Van Loan, "Matrix Computations", 4th ed., section 4.3.5 (banded Cholesky); Takahashi
et al. 1973, "Formation of a sparse bus impedance matrix" (elements of the inverse in the band).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numba import njit
from numpy import ndarray as Array

_LONG = 400
"""Unknowns from which LAPACK, which factorises in blocks, is faster in spite of its wrapper."""


@njit(cache=True, nogil=True)
def add_block(H, g, first, bands, gradient):
    """Add a block on the diagonal, the lower triangle of H (n, n), and its gradient to a system.

    `first` is the index of its first unknown.
    """
    for c in range(len(g)):
        gradient[first + c] += g[c]
        for r in range(c, len(g)):
            bands[r - c, first + c] += H[r, c]


@njit(cache=True, nogil=True)
def add_quadratic(A, slope, x, bands, gradient):
    """Add x (A x / 2 + slope), of a system's first unknowns x (M,), to it; return the energy.

    A (K, M) is a band like `bands` (K, N).
    """
    pull = np.zeros(len(x))
    for c in range(len(x)):
        pull[c] += A[0, c] * x[c]
        bands[0, c] += A[0, c]
        for k in range(1, min(len(A), len(x) - c)):
            pull[c] += A[k, c] * x[c + k]
            pull[c + k] += A[k, c] * x[c]
            bands[k, c] += A[k, c]
    energy = 0.0
    for c in range(len(x)):
        gradient[c] += pull[c] + slope[c]
        energy += x[c] * (0.5 * pull[c] + slope[c])
    return energy


@njit(cache=True, nogil=True)
def eliminate(bands, right, count):
    """Eliminate the first `count` unknowns of a system, in place; False if that is impossible.

    `bands` (K, N) and `right` (N,) of the other unknowns become the system that is left for them
    (Schur complement); those of the first become Cholesky's factor and its solution of `right`.
    """
    width, size = bands.shape
    for j in range(count):
        if not bands[0, j] > 0.0:
            return False
        root, reach = np.sqrt(bands[0, j]), min(width, size - j)
        for k in range(reach):
            bands[k, j] /= root
        right[j] /= root
        for k in range(1, reach):
            factor = bands[k, j]
            if factor == 0.0:
                continue
            right[j + k] -= factor * right[j]
            for m in range(reach - k):
                bands[m, j + k] -= factor * bands[k + m, j]
    return True


def solve_damped(
    bands: Float[Array, "K N"], right: Float[Array, "N"], damping: float
) -> Float[Array, "N"] | None:
    """Solve (A + damping * diag(A)) x = right for A as a band; None unless positive definite."""
    if len(right) < _LONG:
        solvable, x = _solve_damped(bands, right, damping)
        return x if solvable else None
    from scipy.linalg import LinAlgError, solveh_banded

    damped = bands.copy(order="F")
    damped[0] *= 1.0 + damping
    try:
        return solveh_banded(damped, right, lower=True, overwrite_ab=True)
    except LinAlgError:
        return None


@njit(cache=True, nogil=True)
def _solve_damped(bands, right, damping):
    """Whether A is positive definite, and the solution."""
    size = len(right)
    factor, x = np.empty(bands.shape[::-1]).T, right.copy()
    factor[:] = bands
    factor[0] *= 1.0 + damping
    if not eliminate(factor, x, size):
        return False, x
    for i in range(size - 1, -1, -1):
        s = x[i]
        for k in range(1, min(len(bands), size - i)):
            s -= factor[k, i] * x[i + k]
        x[i] = s / factor[0, i]
    return True, x


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def _invert(factor, below, column):
    """Turn Cholesky's factor (K, N) into the inverse's elements in the band, in place.

    `below` and `column` (K - 1,) are scratch.
    """
    width, size = factor.shape
    for j in range(size - 1, -1, -1):
        reach, pivot = min(width, size - j) - 1, factor[0, j]
        for k in range(reach):
            below[k] = factor[k + 1, j] / pivot
            column[k] = 0.0
        # The column is -Z below, for the symmetric block Z of the inverse that is known already.
        for c in range(reach):
            known, rest, found = factor[: reach - c, j + 1 + c], below[c:reach], column[c:reach]
            scale, total = rest[0], 0.0
            for k in range(1, len(known)):
                total += known[k] * rest[k]
                found[k] -= known[k] * scale
            found[0] -= total + known[0] * scale
        diagonal = 1.0 / pivot**2
        for k in range(reach):
            diagonal -= below[k] * column[k]
            factor[k + 1, j] = column[k]
        factor[0, j] = diagonal


@njit(cache=True, nogil=True)
def _diagonal_blocks(bands, blocks):
    """Copy the blocks (T, n, n) on the diagonal out of a symmetric band."""
    n = blocks.shape[1]
    for t in range(len(blocks)):
        for c in range(n):
            for r in range(c, n):
                blocks[t, r, c] = blocks[t, c, r] = bands[r - c, t * n + c]


def banded_inverse(bands: Float[Array, "K N"], size: int) -> Float[Array, "T {size} {size}"]:
    """Diagonal blocks of `size` unknowns of a band matrix's inverse; a block fits into the band.

    Raises LinAlgError where the matrix is not positive definite.
    """
    assert len(bands) >= size and bands.shape[1] % size == 0, (bands.shape, size)
    found, count = np.array(bands, order="F"), bands.shape[1]
    if not eliminate(found, np.zeros(count), count):
        raise np.linalg.LinAlgError("not positive definite")
    _invert(found, np.empty(len(bands) - 1), np.empty(len(bands) - 1))
    blocks = np.empty((count // size, size, size))
    _diagonal_blocks(found, blocks)
    return blocks
