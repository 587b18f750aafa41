"""Compiled: a brightness and a colour to the bytes of a texture."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, UInt8
from numba import njit
from numpy import ndarray as Array


@njit(cache=True, error_model="numpy")
def tinted(value: Float[Array, "H W"], colour: Float[Array, "3"]) -> UInt8[Array, "H W 3"]:
    """sRGB bytes of a colour (0..1) times a brightness at each pixel, cut off at white."""
    height, width = value.shape
    texture = np.empty((height, width, 3), np.uint8)
    for y in range(height):
        for x in range(width):
            for c in range(3):
                level = min(max(value[y, x] * colour[c], np.float32(0.0)), np.float32(1.0))
                texture[y, x, c] = np.uint8(level * np.float32(255.0) + np.float32(0.5))
    return texture
