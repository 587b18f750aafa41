"""Compiled pixel loops: accumulate light and convert it to an image.

The tests compare each with a readable reference (`tests/egocap_sim/sensor/oracles.py`).
"""

from __future__ import annotations

from functools import cache

import numba
import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray as Array

from egocap_sim.sensor.optics import toned

NOISE_SAMPLES = 1 << 20
_STEPS = 4095  # of the encoding table over the square root of light


@cache
def noise_table() -> Float[Array, "NOISE_SAMPLES"]:
    """Standard normal samples, float32, of which every image row takes a run; do not write."""
    return np.random.default_rng(0).standard_normal(NOISE_SAMPLES, dtype=np.float32)


def encoding_table(gamma: float, tone: float = 0.0) -> UInt8[Array, "_STEPS+1"]:
    """Displayed values over the square root of light; `tone` as in `optics.toned`."""
    values = toned((np.arange(_STEPS + 1) / _STEPS) ** gamma, tone)
    return np.rint(255.0 * values).astype(np.uint8)


@numba.njit(cache=True)
def add_light(
    picture: Float[Array, "h W 3"],
    subframe: UInt8[Array, "h W 3"],
    weight: Float[Array, "h"],
    decoding: Float[Array, "256"],
) -> None:
    """Add rows of a rendered sub-frame to an image in linear light, by their weights."""
    height, width, channels = picture.shape
    for y in range(height):
        w = weight[y]
        if w > 0.0:
            for x in range(width):
                for c in range(channels):
                    picture[y, x, c] += w * decoding[subframe[y, x, c]]


@numba.njit(cache=True)
def develop(
    light: Float[Array, "H W 3"],
    gain: float,
    fall_off: Float[Array, "H W"],
    variance_of_light: float,
    variance: float,
    noise: Float[Array, "N"],
    start: Int[Array, "H"],
    encoding: UInt8[Array, "_"],
) -> UInt8[Array, "H W 3"]:
    """Convert light to a displayed image: exposure, vignetting, noise, encoding.

    The noise of row y is the run of `noise` that begins at start[y], at most N - 3 W.
    """
    height, width, channels = light.shape
    image = np.empty(light.shape, np.uint8)
    steps = np.float32(len(encoding) - 1)
    g, shot, read = np.float32(gain), np.float32(variance_of_light), np.float32(variance)
    zero, one, half = np.float32(0.0), np.float32(1.0), np.float32(0.5)
    for y in range(height):
        n = start[y]
        for x in range(width):
            share = g * fall_off[y, x]
            for c in range(channels):
                value = light[y, x, c] * share
                value += np.sqrt(read + shot * max(value, zero)) * noise[n]
                n += 1
                root = np.sqrt(min(max(value, zero), one))
                image[y, x, c] = encoding[int(root * steps + half)]
    return image
