"""Joint angles from joint positions: the pose of the tracker's skeleton nearest to given joints."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.skeleton import DOF_COUNT, SPREAD, HasOffsets, forward, jacobian

TRUST = 0.002
"""Metres of joint error that one everyday spread of an angle is worth, so that none is free."""


def nearest_angles(
    proportions: HasOffsets,
    joints_head: Float[Array, "18 3"],
    start: Float[Array, "37"] | None = None,
) -> Float[Array, "37"]:
    """Angles whose joints lie nearest to the given ones (head frame, metres), least squares.

    Turns that no joint shows, of hands and feet about themselves, stay near rest.
    """
    from scipy.optimize import least_squares

    ease = TRUST / SPREAD

    def residual(angles: Float[Array, "37"]) -> Float[Array, "91"]:
        away = forward(proportions, angles) - joints_head
        return np.concatenate([away.ravel(), ease * angles])

    def slope(angles: Float[Array, "37"]) -> Float[Array, "91 37"]:
        _, J = jacobian(proportions, angles)
        return np.concatenate([J.reshape(-1, DOF_COUNT), np.diag(ease)])

    first = np.zeros(DOF_COUNT) if start is None else start
    return least_squares(residual, first, slope, method="trf").x  # pyright: ignore[reportArgumentType]
