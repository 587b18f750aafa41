"""Each step of `sensor_kernel` as one readable function, which the compiled loops must equal."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap_sim.sensor.light import DECODING


def decode(image: UInt8[Array, "H W 3"]) -> Float[Array, "H W 3"]:
    """Linear light of displayed values, float32."""
    return cv2.LUT(image, DECODING)


def encode(light: Float[Array, "*n"], gamma: float = 1.0) -> UInt8[Array, "*n"]:
    """Displayed values of linear light, clipped to black and white, raised to `gamma`."""
    root = np.sqrt(np.clip(light, 0.0, 1.0))
    return np.rint(255.0 * root**gamma).astype(np.uint8)


def expose(light: Float[Array, "*n"], stops: float) -> Float[Array, "*n"]:
    """Twice the light for every stop; no clipping yet."""
    return light * np.float32(2.0**stops)


def noisy(
    light: Float[Array, "*n"],
    full_well_e: float | None,
    read_noise: float,
    normal: Float[Array, "*n"],
) -> Float[Array, "*n"]:
    """Add shot and read noise, standard `normal` numbers of variance light / full_well_e +
    read_noise^2.

    The Poisson count of electrons is taken as normal, which at 10 electrons and more it nearly is.
    """
    variance = np.float32(read_noise**2)
    if full_well_e is not None:
        variance = variance + np.maximum(light, 0.0) / np.float32(full_well_e)
    return light + np.sqrt(variance) * normal


def add_subframe(
    picture: Float[Array, "H W 3"], subframe: UInt8[Array, "H W 3"], weight: Float[Array, "H"]
) -> None:
    """Add rows of a sub-frame to those of a picture, in linear light: `sensor_kernel.add_light`."""
    picture += weight[:, None, None] * decode(subframe)
