"""Two-bone inverse kinematics: an arm or a leg from its root, its end, and the side it bends to."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.geometry import unit

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
    reach = end - root
    distance = np.linalg.norm(reach, axis=-1, keepdims=True)
    axis = reach / np.maximum(distance, 1e-9)
    distance = np.clip(distance, abs(upper - lower) * 1.05 + 0.02, STRAIGHTEST * (upper + lower))
    side = unit(bend_towards - (bend_towards * axis).sum(-1, keepdims=True) * axis)
    along = (distance**2 + upper**2 - lower**2) / (2.0 * distance)
    out = np.sqrt(np.maximum(upper**2 - along**2, 0.0))
    middle = along * axis + out * side
    left = np.cross(side, axis) if knee else np.cross(axis, side)
    return _bone(middle, left), _bone(distance * axis - middle, left)


def _bone(down: Float[Array, "T 3"], left: Float[Array, "T 3"]) -> Float[Array, "T 3 3"]:
    z = -unit(down)
    return np.stack([np.cross(left, z), left, z], -1)


def bend_angle(upper: Float[Array, "T 3 3"], lower: Float[Array, "T 3 3"]) -> Float[Array, "T"]:
    """Flexion of an elbow or knee in radians: positive where the calf swings back, for a knee."""
    local = np.swapaxes(upper, -1, -2) @ lower
    return np.arctan2(local[..., 0, 2], local[..., 2, 2])
