"""Compiled: a shadow map's depth to what its blur needs, and the blurred to what is looked up."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numba import njit
from numpy import ndarray as Array

_GAP = np.float32(1e-3)  # of the depth range: nearer to the ground nothing casts


@njit(cache=True, error_model="numpy")
def moments_of(depth: Float[Array, "S S"], ground: Float[Array, "3"]) -> Float[Array, "S S 4"]:
    """Depth and its square, how far a caster is from the ground, and whether there is one.

    The ground's depth is ground[0] + ground[1] * column + ground[2] * row; nothing lies beyond it.
    """
    size = len(depth)
    out = np.empty((size, size, 4), np.float32)
    for row in range(size):
        for column in range(size):
            floor = ground[0] + ground[1] * np.float32(column) + ground[2] * np.float32(row)
            d = min(depth[row, column], floor)
            casts = floor - d > _GAP
            out[row, column, 0] = d
            out[row, column, 1] = d * d
            out[row, column, 2] = floor - d if casts else np.float32(0.0)
            out[row, column, 3] = np.float32(1.0) if casts else np.float32(0.0)
    return out


@njit(cache=True, error_model="numpy")
def softened(
    sharp: Float[Array, "S S 4"],
    half: Float[Array, "S S 4"],
    wide: Float[Array, "S S 4"],
    gaps: Float[Array, "2"],
) -> Float[Array, "S S 2"]:
    """Depth and its square, as blurred as the casters around are far from the ground.

    `half` and `wide` are means over the penumbrae of casters at the `gaps`; between them and
    `sharp` it is interpolated.
    """
    size, zero, one = len(sharp), np.float32(0.0), np.float32(1.0)
    out = np.empty((size, size, 2), np.float32)
    for row in range(size):
        for column in range(size):
            casters = wide[row, column, 3]
            gap = wide[row, column, 2] / casters if casters > np.float32(1e-6) else zero
            some = min(gap / gaps[0], one)
            more = min(max((gap - gaps[0]) / (gaps[1] - gaps[0]), zero), one)
            for k in range(2):
                d = sharp[row, column, k]
                d += some * (half[row, column, k] - d)
                out[row, column, k] = d + more * (wide[row, column, k] - d)
    return out
