"""Two-bone inverse kinematics: an arm or a leg from its root, its end, and the side it bends to."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float
from numba import njit
from numpy import ndarray as Array

from egocap_sim.motion.kinematics.vectors import (
    Axes,
    Vector,
    cross,
    dot,
    length,
    plus,
    put,
    scaled,
    unit,
    vector,
)  # fmt: skip

STRAIGHTEST = 0.998  # of the limb's length: farther ends are brought back, nothing hyperextends


def two_bones(
    root: Float[Array, "T 3"],
    end: Float[Array, "T 3"],
    bend_towards: Float[Array, "T 3"],
    upper: float,
    lower: float,
    *,
    knee: bool,
) -> tuple[Float[Array, "T 3 3"], Float[Array, "T 3 3"]]:
    """Canonical world rotations of the upper and lower bone (thigh and calf, or the arm's).

    The middle joint lies to the side of `bend_towards`. A knee's hinge is the body's left axis; an
    elbow's flexion turns the other way about it.
    """
    upper_R, lower_R = np.empty((len(root), 3, 3)), np.empty((len(root), 3, 3))
    reach = np.ascontiguousarray(end - root)
    _bend_all(reach, np.array(bend_towards, order="C"), upper, lower, knee, upper_R, lower_R)
    return upper_R, lower_R


@njit(cache=True)
def _bend_all(
    reach: Float[Array, "T 3"],
    bend_towards: Float[Array, "T 3"],
    upper: float,
    lower: float,
    knee: bool,
    upper_R: Float[Array, "T 3 3"],
    lower_R: Float[Array, "T 3 3"],
) -> None:
    for t in range(len(reach)):
        a, b = bent(vector(reach[t]), vector(bend_towards[t]), upper, lower, knee)
        put(upper_R[t], a)
        put(lower_R[t], b)


@njit(cache=True)
def bent(
    reach: Vector, bend_towards: Vector, upper: float, lower: float, knee: bool
) -> tuple[Axes, Axes]:
    """`two_bones` of one frame, `reach` from the root to the end."""
    distance = length(reach)
    axis = scaled(reach, 1.0 / max(distance, 1e-9))
    nearest, farthest = abs(upper - lower) * 1.05 + 0.02, STRAIGHTEST * (upper + lower)
    distance = min(max(distance, nearest), farthest)
    side = unit(plus(bend_towards, axis, -dot(bend_towards, axis)))
    along = (distance**2 + upper**2 - lower**2) / (2.0 * distance)
    out = math.sqrt(max(upper**2 - along**2, 0.0))
    middle = plus(scaled(axis, along), side, out)
    left = cross(side, axis) if knee else cross(axis, side)
    return _bone(middle, left), _bone(plus(scaled(axis, distance), middle, -1.0), left)


@njit(cache=True)
def _bone(down: Vector, left: Vector) -> Axes:
    z = scaled(unit(down), -1.0)
    return cross(left, z), left, z


def bend_angle(upper: Float[Array, "T 3 3"], lower: Float[Array, "T 3 3"]) -> Float[Array, "T"]:
    """Flexion of an elbow or knee in radians: positive where the calf swings back, for a knee."""
    local = np.swapaxes(upper, -1, -2) @ lower
    return np.arctan2(local[..., 0, 2], local[..., 2, 2])
