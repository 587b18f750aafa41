"""What lies behind the body: the background's colour in every direction of a room that stays.

The rig turns in the room; colours are kept by direction in the room, so that a floor under the hand
is compared with what was seen there before the hand came. Directions are of one view each, at an
angle of about 3 degrees, so that small movements of the head do not matter. Where nothing was seen
yet, the colours of the whole background count.

Source: background subtraction by running averages, e.g. Wren et al. 1997, "Pfinder"; mosaics of
turning cameras: Mittal & Huttenlocher 2000.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float32, Int
from numba import njit
from numpy import ndarray as Array

from egocap.image_model.image_rays import ImageRays
from egocap.image_model.kernel_arrays import Palettes
from egocap.image_model.palette import CLEAR, LOG_RATIO, Background, ColourBins, Palette

ROWS, COLUMNS = 64, 128
"""Cells of latitude and longitude."""
KNOWN = 2
"""Frames after which a cell's colour is used."""
SCATTER = 0.7
"""Standard deviation of a cell's colour in bins."""
OTHER = 0.1
"""Probability that a cell shows something else of the background."""
RATE, SLOW_RATE = 0.1, 0.02
"""Fraction of a new colour that a cell takes over; of one that is more than `FAR` bins off."""
FAR, SETTLED = 2.0, 5
"""The slow rate holds for cells of more than so many frames."""


class Panorama:
    """Colours of the background by direction, updated from frame to frame."""

    def __init__(self, rays: ImageRays, bins: ColourBins) -> None:
        self._rays, self._bins = rays, bins
        cells = len(rays.origins) * ROWS * COLUMNS
        self._mean = np.zeros((cells, 3), np.float32)  # in bins
        self._frames = np.zeros(cells, np.int64)
        self._whole = Background(bins)
        self._head = np.eye(3)  # of the room, in the head frame
        self._cell = self._cells()

    def turn(self, rotation: Float[Array, "3 3"]) -> None:
        """Turn the room in the head frame: what was at a direction d is now at rotation d."""
        self._head = rotation @ self._head
        self._cell = self._cells()

    def compare(self, palette: Palette, hsv: Float32[Array, "P 3"]) -> Palettes:
        """Every ray's dissimilarity to every Gaussian, for `ImageModel.evaluate`."""
        bins, cell = self._bins.of(hsv), self._cell
        squared = ((self._bins.coordinates(hsv) - self._mean[cell]) ** 2).sum(1) / SCATTER**2
        here = np.exp(-0.5 * squared) / (2.0 * np.pi * SCATTER**2) ** 1.5
        anywhere = self._whole.density()[bins]
        behind = np.where(
            self._frames[cell] >= KNOWN, (1.0 - OTHER) * here + OTHER * anywhere, anywhere
        )
        unlike = np.empty((len(palette.log_density), len(bins)), np.float32)
        _compare(np.log(behind).astype(np.float32), palette.log_density, bins, unlike)
        return Palettes(np.arange(len(bins), dtype=np.int32), unlike)

    def update(self, hsv: Float32[Array, "P 3"], opacity: Float32[Array, "P"]) -> None:
        """Learn the colours of a frame whose rays the body covers by `opacity`."""
        self._whole.update(self._bins.of(hsv), opacity)
        free = opacity < CLEAR
        colours = self._bins.coordinates(hsv[free])
        cell, inverse = np.unique(self._cell[free], return_inverse=True)
        count = np.bincount(inverse)
        new = np.stack([np.bincount(inverse, c) for c in colours.T], -1) / count[:, None]
        old, frames = self._mean[cell], self._frames[cell]
        strange = ((new - old) ** 2).sum(1) > FAR**2
        rate = np.maximum(1.0 / (frames + 1.0), RATE)
        rate = np.where(strange & (frames > SETTLED), SLOW_RATE, rate)
        self._mean[cell] = old + rate[:, None] * (new - old)
        self._frames[cell] += 1

    def _cells(self) -> Int[Array, "P"]:
        x, y, z = (self._rays.direction @ self._head).T
        row = ((np.arcsin(np.clip(z, -1.0, 1.0)) / np.pi + 0.5) * ROWS).astype(int)
        column = ((np.arctan2(y, x) / (2.0 * np.pi) + 0.5) * COLUMNS).astype(int) % COLUMNS
        return (self._rays.view * ROWS + np.minimum(row, ROWS - 1)) * COLUMNS + column


@njit(cache=True, nogil=True)
def _compare(behind, own, bins, unlike):
    """As `palette.Background.compare`, where every ray has its own background."""
    scale = np.float32(1.0 / LOG_RATIO)
    for q in range(len(own)):
        for p in range(len(bins)):
            ratio = (behind[p] - own[q, bins[p]]) * scale
            unlike[q, p] = min(max(ratio, np.float32(-1.0)), np.float32(1.0))
