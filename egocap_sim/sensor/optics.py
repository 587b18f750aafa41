"""Faults of lens and colour processing as pure functions: glare, aberration, white balance, tone.

In: linear light, or displayed 8-bit values; out: the same. Light is 0 at black and 1 at white.
"""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.cameras.camera import Camera

_GLARE_WIDTH = 0.08  # standard deviation of scattered light, image widths
_SMALL = 8  # the scattered light is computed at this reduction
_LUMA = (0.299, 0.587, 0.114)  # Source: ITU-R BT.601


def glare(light: Float[Array, "H W 3"], share: float) -> Float[Array, "H W 3"]:
    """Scatter a share of the light widely, as the elements of a lens do; the sum is kept.

    Bright windows and lamps thereby veil what is around them.
    """
    height, width = light.shape[:2]
    size = max(1, width // _SMALL), max(1, height // _SMALL)
    small = cv2.resize(light, size, interpolation=cv2.INTER_AREA)
    sigma = _GLARE_WIDTH * width / _SMALL
    small = cv2.GaussianBlur(small, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
    spread = cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR)
    return (1.0 - share) * light + share * spread


def aberrated(
    light: Float[Array, "H W 3"], camera: Camera, strength: float
) -> Float[Array, "H W 3"]:
    """Lateral chromatic aberration: red is magnified by 1 + strength, blue by 1 - strength."""
    height, width = light.shape[:2]
    centre = np.array(camera.centre)
    made = light.copy()
    for channel, scale in ((0, 1.0 + strength), (2, 1.0 - strength)):
        M = np.column_stack([scale * np.eye(2), (1.0 - scale) * centre])
        made[..., channel] = cv2.warpAffine(
            np.ascontiguousarray(light[..., channel]), M, (width, height)
        )
    return made


def balance_gains(warmth_ev: float) -> Float[Array, "3"]:
    """Gains of red, green and blue of a white balance that is `warmth_ev` stops too warm."""
    return np.array([2.0 ** (warmth_ev / 2), 1.0, 2.0 ** (-warmth_ev / 2)], np.float32)


def toned(values: Float[Array, "*n"], strength: float) -> Float[Array, "*n"]:
    """S-curve of displayed values 0 to 1: darker shadows, brighter highlights."""
    return values + strength * (values**2 * (3.0 - 2.0 * values) - values)


def saturated(image: UInt8[Array, "H W 3"], saturation: float) -> UInt8[Array, "H W 3"]:
    """Scale the colourfulness of displayed values; 0 is a monochrome camera."""
    M = saturation * np.eye(3) + (1.0 - saturation) * np.tile(_LUMA, (3, 1))
    return cv2.transform(image, M.astype(np.float32))
