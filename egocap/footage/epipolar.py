"""Rotation and direction of translation between two pictures of a rigid scene, from its rays.

The robust epipolar error r2 . (t x R r1) is minimised, which is free of the depth of the scene.
Compiled, as pictures are many and their points few.

Source: epipolar constraint on rays, Hartley & Zisserman 2004, ch. 9; loss, Geman & McClure 1987.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numba import njit
from numpy import ndarray as Array

_ROUNDS, _PROCRUSTES_ROUNDS = 10, 6


@dataclass(frozen=True, eq=False)
class Motion:
    """A solution of the epipolar constraint."""

    R: Float[Array, "3 3"]  # rays of the picture before to rays now
    t: Float[Array, "3"]  # unit vector
    cost: float


def relative_motion(
    r1: Float[Array, "n 3"],
    r2: Float[Array, "n 3"],
    noise: float,
    before: Motion | None = None,
) -> Motion:
    """Rotation and direction of translation that moved rays r1 of a rigid scene to r2.

    `noise` is the standard deviation of a ray [rad] where nothing else disturbs it. The solution is
    the better one of two starts: the rotation alone, and the motion of the interval before.
    """
    r1, r2 = np.ascontiguousarray(r1, float), np.ascontiguousarray(r2, float)
    R = _robust_rotation(r1, r2, noise)
    starts = [(R, _direction(np.cross(r1 @ R.T, r2)))]
    if before is not None:
        starts.append((before.R, before.t))
    return min((Motion(*_refined(r1, r2, *s, noise)) for s in starts), key=lambda m: m.cost)


@njit(cache=True, nogil=True)
def _refined(r1, r2, R, t, noise):
    """Gauss-Newton over rotation and direction, with a loss that narrows: R, t, cost."""
    for i in range(_ROUNDS):
        width = 3.0 * noise * 2.0 ** max(3 - i, 0)
        across = _orthogonal(t)
        H, g = _normal_equations(r1, r2, R, t, across, width)
        step = -np.linalg.solve(H, g)
        R = _rotation(step[:3]) @ R
        t = t + step[3] * across[0] + step[4] * across[1]
        t = t / np.sqrt(np.sum(t * t))
    squared = (np.cross(r1 @ R.T, r2) @ t / (3.0 * noise)) ** 2
    return R, t, np.sum(squared / (1.0 + squared))


@njit(cache=True, nogil=True)
def _normal_equations(r1, r2, R, t, across, width):
    """H (5, 5) and g (5,) of a step in rotation and direction."""
    H, g, J = 1e-7 * np.eye(5), np.zeros(5), np.empty(5)
    u, v = across
    turned = r1 @ R.T
    for k in range(len(r1)):
        a, b = turned[k], r2[k]
        x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
        error = x * t[0] + y * t[1] + z * t[2]
        along = a[0] * t[0] + a[1] * t[1] + a[2] * t[2]
        cosine = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
        for c in range(3):
            J[c] = b[c] * along - t[c] * cosine
        J[3] = u[0] * x + u[1] * y + u[2] * z
        J[4] = v[0] * x + v[1] * y + v[2] * z
        weight = 1.0 / (1.0 + (error / width) ** 2) ** 2
        for a in range(5):
            g[a] += weight * error * J[a]
            for b in range(5):
                H[a, b] += weight * J[a] * J[b]
    return H, g


@njit(cache=True, nogil=True)
def _orthogonal(t):
    """Two unit vectors orthogonal to t and to each other."""
    other = np.zeros(3)
    other[np.argmin(np.abs(t))] = 1.0
    first = np.cross(t, other)
    first /= np.sqrt(np.sum(first * first))
    return first, np.cross(t, first)


@njit(cache=True, nogil=True)
def _robust_rotation(r1, r2, noise):
    """Rotation alone, by iteratively re-weighted orthogonal Procrustes."""
    weight, R = np.ones(len(r1)), np.eye(3)
    for _ in range(_PROCRUSTES_ROUNDS):
        U, _, Vt = np.linalg.svd((r2 * weight.reshape(-1, 1)).T @ r1)
        R = U @ np.diag(np.array([1.0, 1.0, np.linalg.det(U @ Vt)])) @ Vt
        error = np.sqrt(np.sum((r2 - r1 @ R.T) ** 2, axis=1))
        scale = max(1.4826 * np.median(error), noise)
        weight = 1.0 / (1.0 + (error / scale) ** 2) ** 2
    return R


def _direction(normal: Float[Array, "n 3"]) -> Float[Array, "3"]:
    """Unit vector most orthogonal to the normals."""
    return np.ascontiguousarray(np.linalg.eigh(normal.T @ normal)[1][:, 0])


@njit(cache=True, nogil=True)
def _rotation(vector):
    """Rotation by a vector (Rodrigues' formula)."""
    angle = np.sqrt(np.sum(vector * vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * (K @ K)
