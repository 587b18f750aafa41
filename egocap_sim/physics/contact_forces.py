"""Contact forces of the floor on the feet that best reproduce a root wrench; compiled."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from numba import njit
from numpy import ndarray as Array

_EDGES = np.array([(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)])  # of a friction pyramid
_MOST_STEPS, _LEAST_SHARE = 50, 1e-9  # of Newton's method, and of one of its steps


@njit(cache=True)
def contact_forces(
    points: Float[Array, "N 3"],
    foot: Int[Array, "N"],
    slope: Float[Array, "4"],
    feet: Float[Array, "4 3"],
    pelvis: Float[Array, "3"],
    R_world_pelvis: Float[Array, "3 3"],
    wrench: Float[Array, "6"],
    torque_weight: float,
    regularisation: float,
) -> Float[Array, "4 6"]:
    """The floor's best force [N] and torque [N m] on each of the feet, world frame.

    Each contact is at a point of a foot; forces lie in friction pyramids of each foot's `slope`.
    Their sum fits a root wrench in the least-squares sense: a force in the world's frame and a
    torque about the pelvis, in its frame, weighted by `torque_weight` [1/m].
    """
    columns, R = np.empty((6, 4 * len(points))), R_world_pelvis
    for c in range(columns.shape[1]):
        k, edge = c // 4, _EDGES[c % 4]
        u, v = slope[foot[k]] * edge[0], slope[foot[k]] * edge[1]
        columns[0, c], columns[1, c], columns[2, c] = u, v, 1.0
        x, y, z = _torque(points[k], pelvis, u, v, 1.0)
        for axis in range(3):
            turned = R[0, axis] * x + R[1, axis] * y + R[2, axis] * z
            columns[3 + axis, c] = torque_weight * turned
    weighted = wrench.copy()
    weighted[3:] *= torque_weight
    shares = nonnegative_least_squares(columns, weighted, regularisation)
    plan = np.zeros((len(feet), 6))
    for c, share in enumerate(shares):
        f = foot[c // 4]
        u, v = share * columns[0, c], share * columns[1, c]
        x, y, z = _torque(points[c // 4], feet[f], u, v, share)
        for i, value in enumerate((u, v, share, x, y, z)):
            plan[f, i] += value
    return plan


@njit(cache=True)
def _torque(
    point: Float[Array, "3"], about: Float[Array, "3"], fx: float, fy: float, fz: float
) -> tuple[float, float, float]:
    """Torque of a force at a point about another."""
    x, y, z = point[0] - about[0], point[1] - about[1], point[2] - about[2]
    return y * fz - z * fy, z * fx - x * fz, x * fy - y * fx


@njit(cache=True)
def nonnegative_least_squares(
    C: Float[Array, "D N"], w: Float[Array, "D"], r: float
) -> Float[Array, "N"]:
    """The x >= 0 that minimises |C x - w|^2 + r^2 |x|^2.

    It is max(0, C' y) for the y that minimises f = r^2 |y|^2 + |max(0, C' y)|^2 - 2 w' y, convex
    and piecewise quadratic, with D unknowns for any N. Newton's method is exact once a full step
    changes no active column; a step that does not lower f is halved.
    """
    y, pull, least = np.zeros(len(w)), w @ C, 0.0
    for _ in range(_MOST_STEPS):
        active = pull > 0.0
        H = (C * active) @ C.T + r * r * np.eye(len(w))
        step = np.linalg.solve(H, w) - y
        value, share = np.inf, 2.0
        while not value < least and share > _LEAST_SHARE:
            share *= 0.5
            new = y + share * step
            pull = new @ C
            shares = np.maximum(pull, 0.0)
            value = r * r * (new @ new) + shares @ shares - 2.0 * (w @ new)
        if not value < least or (share == 1.0 and (active == (pull > 0.0)).all()):
            break
        y, least = new, value
    return shares
