"""Faults of one image as pure functions: vignetting, lamp flicker, JPEG compression.

Linear light is 0 at black and 1 at white; the renderer's 8-bit values are its square roots.

Source: the mean of cos(w t) over an exposure of s seconds around t is sinc(w s / 2) cos(w t), so
that exposures of whole half periods of the mains (1/100 s at 50 Hz) show no flicker.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.cameras.camera import Camera
from egocap_sim.render.pixel_rays import pixel_rays
from egocap_sim.sensor.config import SensorTable
from egocap_sim.sensor.timing import row_time

DECODING = (np.arange(256, dtype=np.float32) / 255.0) ** 2
"""Linear light of the 256 displayed values, float32."""


def vignette(camera: Camera, strength: float, rim: float = 0.0) -> Float[Array, "H W"]:
    """Share of the light that reaches each pixel: 1 - strength (theta / theta_max)^2.

    theta is the angle off the axis; at the edge of the lens `strength` of the light is lost. Over
    the outer share `rim` of the field of view the light fades to 0.
    """
    _, theta = pixel_rays(camera)
    ratio = np.minimum(theta / camera.max_angle, 1.0)
    light = 1.0 - strength * ratio**2
    if rim:
        light *= np.clip((1.0 - ratio) / rim, 0.0, 1.0)
    return light.astype(np.float32)


def compress(image: UInt8[Array, "H W 3"], quality: int) -> UInt8[Array, "H W 3"]:
    """Encode as JPEG and decode, with chroma at half resolution as in cameras."""
    import simplejpeg

    data = simplejpeg.encode_jpeg(
        np.ascontiguousarray(image), quality=quality, colorspace="RGB", colorsubsampling="420"
    )
    return simplejpeg.decode_jpeg(data, colorspace="RGB")


def lamp_light(times: Float[Array, "*n"], sensor: SensorTable, phase: float) -> Float[Array, "*n"]:
    """Mean light over exposures centred at `times` [s], relative to a steady lamp.

    `phase` (radians) is that of the light at time zero.
    """
    twice = 2.0 * sensor.mains_hz
    seen = sensor.flicker * np.sinc(twice * sensor.shutter_s)  # numpy's sinc has the pi in it
    return 1.0 + seen * np.cos(2.0 * np.pi * twice * np.asarray(times, float) + phase)


def lamp_rows(middle: float, height: int, sensor: SensorTable, phase: float) -> Float[Array, "H"]:
    """`lamp_light` of every row of an image whose middle row is exposed at `middle` [s]."""
    rows = row_time(np.full(height, middle), np.arange(height), height, sensor.readout_s)
    return lamp_light(rows, sensor, phase)


def lamp_phase(rng: np.random.Generator) -> float:
    """Draw the phase of the mains at time zero, radians."""
    return float(rng.uniform(0.0, 2.0 * np.pi))
