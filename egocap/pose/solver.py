"""Levenberg-Marquardt on one frame, compiled.

Source: Nocedal & Wright, Numerical Optimization, 2nd ed., section 10.3; the damping follows
Marquardt 1963 (scaled by the diagonal), raised tenfold on failure and lowered on success.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numba import njit
from numpy import ndarray as Array

from egocap.pose.kernel import detections, priors, smoothness


class Prediction(NamedTuple):
    """The pose predicted from the past, a Gaussian; an empty `sigma` leaves the term out."""

    mean: Float[Array, "37"]
    sigma: Float[Array, "D"]  # 37, or 0


NO_PREDICTION = Prediction(np.zeros(0), np.zeros(0))


@njit(cache=True, nogil=True)
def cholesky_solve(H, damping, b, L, x):  # H (N,N) lower triangle, b (N,); L (N,N), x (N,): outputs
    """Solve (H + damping * diag(H)) x = b; False when the matrix is not positive definite."""
    n = len(b)
    for i in range(n):
        for j in range(i + 1):
            s = H[i, j] if i != j else H[i, i] * (1.0 + damping)
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j:
                if not s > 0.0:
                    return False
                L[i, i] = np.sqrt(s)
            else:
                L[i, j] = s / L[j, j]
    for i in range(n):
        s = b[i]
        for k in range(i):
            s -= L[i, k] * x[k]
        x[i] = s / L[i, i]
    for i in range(n - 1, -1, -1):
        s = x[i]
        for k in range(i + 1, n):
            s -= L[k, i] * x[k]
        x[i] = s / L[i, i]
    return True


@njit(cache=True, nogil=True)
def _energy(model, angles, prediction, seen, scale, H, g):
    H[:] = 0.0
    g[:] = 0.0
    energy = detections(model, angles, seen, scale, H, g)
    energy += priors(model, angles, H, g)
    if len(prediction.sigma) > 0:
        energy += smoothness(model, angles, prediction.mean, prediction.sigma, H, g)
    return energy


@njit(cache=True, nogil=True)
def solve_frame(model, start, prediction, seen, scale, iterations, tolerance):
    """Minimise one frame's energy from a start.

    `prediction` is a `Prediction`, `seen` the `Rays` of the frame. Returns angles (37,), energy,
    converged, steps. Converged: a step lowered the energy by less than `tolerance` of itself, or
    none can.
    """
    n = len(start)
    angles, trial = start.copy(), np.empty(n)
    H, g = np.empty((n, n)), np.empty(n)
    H_new, g_new = np.empty((n, n)), np.empty(n)
    L, step = np.zeros((n, n)), np.empty(n)
    damping = 1e-3
    energy = _energy(model, angles, prediction, seen, scale, H, g)
    for iteration in range(iterations):
        while not cholesky_solve(H, damping, -g, L, step):
            damping = max(10.0 * damping, 1e-6)
            if damping > 1e12:
                return angles, energy, False, iteration
        # The linearisation does not hold over more than a radian.
        longest = np.abs(step).max()
        shrink = 1.0 if longest < 1.0 else 1.0 / longest
        for d in range(n):
            trial[d] = angles[d] + shrink * step[d]
        new = _energy(model, trial, prediction, seen, scale, H_new, g_new)
        if new <= energy:
            gain = energy - new
            angles[:], H[:], g[:] = trial, H_new, g_new
            energy = new
            damping = max(0.2 * damping, 1e-9)
            if gain <= tolerance * (energy + 1e-3) and shrink == 1.0:
                return angles, energy, True, iteration + 1
        else:
            if damping > 1e8 or longest < 1e-7:
                return angles, energy, True, iteration + 1
            damping *= 10.0
    return angles, energy, False, iterations
