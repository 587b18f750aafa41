"""What a sensor does to the light of one picture: each fault one pure function.

Linear light is 0 at black and 1 at white. The renderer's 8-bit values are its square roots, so that
`encode(decode(image))` gives any image back.
"""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.cameras.camera import Camera
from egocap_sim.render.pixel_rays import pixel_rays

DECODING = (np.arange(256, dtype=np.float32) / 255.0) ** 2
"""Linear light of the 256 displayed values, float32."""


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


def vignette(camera: Camera, strength: float) -> Float[Array, "H W"]:
    """Share of the light that reaches each pixel: 1 - strength (theta / theta_max)^2.

    theta is the angle off the axis; at the rim of the lens `strength` of the light is lost.
    """
    _, theta = pixel_rays(camera)
    ratio = np.minimum(theta / camera.max_angle, 1.0)
    return (1.0 - strength * ratio**2).astype(np.float32)


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


def compress(image: UInt8[Array, "H W 3"], quality: int) -> UInt8[Array, "H W 3"]:
    """Through JPEG and back, with chroma at half the resolution as cameras store it."""
    import simplejpeg

    data = simplejpeg.encode_jpeg(
        np.ascontiguousarray(image), quality=quality, colorspace="RGB", colorsubsampling="420"
    )
    return simplejpeg.decode_jpeg(data, colorspace="RGB")
