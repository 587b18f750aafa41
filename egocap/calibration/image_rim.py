"""Where a fisheye's image ends: the angle beyond which all pictures are dark."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from egocap.cameras.camera import Camera

_MOST = 15  # pictures
_STEP = np.deg2rad(1.0)
_DARK = 0.2  # of the brightness inside
_FARTHEST = np.deg2rad(149.0)  # of any rig file


def rim_angle(pictures: Mapping[int, UInt8[Array, "H W"]], camera: Camera, widest: float) -> float:
    """Half the field of view [rad]: where the image circle ends, or the image.

    `widest` is the angle of the outermost corner, which the field reaches at least.
    """
    shown = list(pictures.values())[:: max(1, len(pictures) // _MOST)]
    median = np.median([picture[::4, ::4] for picture in shown], axis=0)
    rows, columns = 4 * np.indices(median.shape)
    rays, _ = camera.ray(np.stack([columns, rows], -1))
    theta = np.arccos(np.clip(rays[..., 2], -1.0, 1.0))
    place = (theta / _STEP).astype(int).ravel()
    count = np.bincount(place)
    profile = np.bincount(place, median.ravel()) / np.maximum(count, 1)
    inside = np.median(profile[: int(widest / _STEP) + 1])
    bright = np.flatnonzero((profile > _DARK * inside) & (count > 0))
    end = min(float((bright[-1] + 1) * _STEP), camera.max_angle, _FARTHEST)
    return max(end, widest)
