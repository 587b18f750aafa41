"""The exponential map of rotations and its derivative.

Source: Sola, Deray & Atchuthan 2018, "A micro Lie theory for state estimation in robotics",
equation 143.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.geometry import axis_angle, skew, unit

_SMALL = 1e-5  # radians


def exponential(turn: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """Rotation matrices of rotation vectors, rad."""
    return axis_angle(unit(turn), np.linalg.norm(turn, axis=-1))


def right_jacobian(turn: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """J with exp(turn + d) = exp(turn) exp(J d) for small d."""
    angle = np.linalg.norm(turn, axis=-1)[..., None, None]
    safe = np.where(angle > _SMALL, angle, 1.0)
    first = np.where(angle > _SMALL, (1.0 - np.cos(safe)) / safe**2, 0.5)
    second = np.where(angle > _SMALL, (safe - np.sin(safe)) / safe**3, 1.0 / 6.0)
    K = skew(turn)
    return np.eye(3) - first * K + second * (K @ K)
