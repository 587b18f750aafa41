"""What lies behind the body: the background's colour along every ray, as rig and light change.

The rig turns in the room; colours are kept by direction in the room, so that a floor under the hand
is compared with what was seen there before the hand came. Directions are of one view each, at an
angle of about 3 degrees, so that small movements of the head do not matter. What is fixed to the
rig, as its own parts, is kept by ray. Of the two the likelier counts; where neither was seen yet,
the colours of the whole background. A pixel that moves against the room is unlikely to show it.

Source: background subtraction by running averages, e.g. Wren et al. 1997, "Pfinder"; mosaics of
turning cameras: Mittal & Huttenlocher 2000; light: von Kries 1902 (diagonal adaptation).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from numba import njit
from numpy import ndarray as Array

from egocap.image_model.colour_measure import hsv_to_rgb
from egocap.image_model.illumination import BRIGHT, DARK
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
"""Probability that a pixel shows something else of the background."""
RATE, SLOW_RATE = 0.1, 0.02
"""Fraction of a new colour that a cell takes over; of one that is more than `FAR` bins off."""
FAR, SETTLED = 2.0, 5
"""The slow rate holds for cells of more than so many frames."""
TURNED = np.deg2rad(10.0)
"""Turn of the rig from which what a ray still shows is learned as a part of the rig."""
A_PIXEL, MOST = 1.5, 4.0
"""By how much a pixel's motion lowers the logarithm of the background's likelihood; the bound."""
SMOOTHED = 5
"""Frames between two histograms of the whole background."""
FEWEST = 100
"""Pixels under which no change of the light is estimated."""


class Panorama:
    """Colours of the background, updated from frame to frame."""

    def __init__(self, rays: ImageRays, bins: ColourBins) -> None:
        self._rays, self._bins = rays, bins
        cells = len(rays.origins) * ROWS * COLUMNS
        self._mean = np.zeros((cells, 3), np.float32)  # in bins
        self._rgb = np.zeros((cells, 3))
        self._frames = np.zeros(cells, np.int64)
        self._on_rig = np.zeros((len(rays), 3), np.float32)  # in bins
        self._rig_frames, self._rig_head = np.zeros(len(rays), np.int64), np.eye(3)
        self._whole, self._updates = Background(bins), 0
        self._anywhere = self._whole.density()
        self._head = np.eye(3)  # of the room, in the head frame
        self._cell = self._cells()

    def turn(self, rotation: Float[Array, "3 3"]) -> None:
        """Turn the room in the head frame: what was at a direction d is now at rotation d."""
        self._head = rotation @ self._head
        self._cell = self._cells()

    def compare(
        self, palette: Palette, hsv: Float32[Array, "P 3"], moved: Float[Array, "P"] | None = None
    ) -> Palettes:
        """Every ray's dissimilarity to every Gaussian, for `ImageModel.evaluate`.

        `moved` is each pixel's motion against the room, of `MovingPixels`.
        """
        seen = self._bins.coordinates(hsv)
        bins = self._bins.at(seen)
        anywhere = self._anywhere[bins]
        room = np.where(self._frames[self._cell] >= KNOWN, _density(seen, self._mean[self._cell]),
                        anywhere)  # fmt: skip
        rig = np.where(self._rig_frames >= KNOWN, _density(seen, self._on_rig), 0.0)
        behind = np.log((1.0 - OTHER) * np.maximum(room, rig) + OTHER * anywhere)
        if moved is not None:
            behind -= np.minimum(A_PIXEL * moved, MOST)
        unlike = np.empty((len(palette.log_density), len(bins)), np.float32)
        _compare(behind.astype(np.float32), palette.log_density, bins, unlike)
        return Palettes(np.arange(len(bins), dtype=np.int32), unlike)

    def light(
        self, hsv: Float32[Array, "P 3"], opacity: Float[Array, "P"]
    ) -> Float[Array, "3"] | None:
        """Factors on red, green and blue since the background was learned, by its median pixel.

        Its first colours count, so that errors do not add up. None where too little of it is seen.
        """
        known = (opacity < CLEAR) & (self._frames[self._cell] >= KNOWN)
        now, then = hsv_to_rgb(hsv[known]), self._rgb[self._cell[known]]
        told = ((now > DARK) & (now < BRIGHT) & (then > DARK)).all(1)
        if told.sum() < FEWEST:
            return None
        return np.exp(np.median(np.log(now[told] / then[told]), axis=0))

    def update(self, hsv: Float32[Array, "P 3"], opacity: Float[Array, "P"]) -> None:
        """Learn the colours of a frame whose rays the body covers by `opacity`."""
        seen = self._bins.coordinates(hsv)
        self._whole.update(self._bins.at(seen), opacity)
        if self._updates % SMOOTHED == 0:
            self._anywhere = self._whole.density()
        self._updates += 1
        free = opacity < CLEAR
        self._learn_room(seen[free], hsv_to_rgb(hsv[free]), self._cell[free])
        turned = np.trace(self._head @ self._rig_head.T) < 1.0 + 2.0 * np.cos(TURNED)
        if turned or not self._rig_frames.any():
            self._rig_head = self._head
            self._learn_rig(seen[free], free)

    def _learn_room(
        self, seen: Float32[Array, "N 3"], rgb: Float32[Array, "N 3"], at: Int[Array, "N"]
    ) -> None:
        counts = np.bincount(at, minlength=len(self._frames))
        cell = np.flatnonzero(counts)
        new, colour = (
            np.stack([np.bincount(at, c, len(counts))[cell] for c in values.T], -1)
            / counts[cell, None]
            for values in (seen, rgb)
        )
        old, frames = self._mean[cell], self._frames[cell]
        strange = ((new - old) ** 2).sum(1) > FAR**2
        even = 1.0 / (frames + 1.0)
        rate = np.where(strange & (frames > SETTLED), SLOW_RATE, np.maximum(even, RATE))
        self._mean[cell] = old + rate[:, None] * (new - old)
        self._rgb[cell] += even[:, None] * (colour - self._rgb[cell])
        self._frames[cell] += 1

    def _learn_rig(self, seen: Float32[Array, "N 3"], free: Bool[Array, "P"]) -> None:
        rate = np.maximum(1.0 / (self._rig_frames[free] + 1.0), RATE)
        self._on_rig[free] += rate[:, None] * (seen - self._on_rig[free])
        self._rig_frames[free] += 1

    def _cells(self) -> Int[Array, "P"]:
        x, y, z = (self._rays.direction @ self._head).T
        row = ((np.arcsin(np.clip(z, -1.0, 1.0)) / np.pi + 0.5) * ROWS).astype(int)
        column = ((np.arctan2(y, x) / (2.0 * np.pi) + 0.5) * COLUMNS).astype(int) % COLUMNS
        return (self._rays.view * ROWS + np.minimum(row, ROWS - 1)) * COLUMNS + column


def _density(seen: Float32[Array, "P 3"], mean: Float32[Array, "P 3"]) -> Float32[Array, "P"]:
    """Probability of colours, all in bins, where a mean is expected."""
    squared = ((seen - mean) ** 2).sum(1) / SCATTER**2
    return np.exp(-0.5 * squared) / (2.0 * np.pi * SCATTER**2) ** 1.5


@njit(cache=True, nogil=True)
def _compare(behind, own, bins, unlike):
    """As `palette.Background.compare`, where every ray has its own background."""
    scale = np.float32(1.0 / LOG_RATIO)
    for q in range(len(own)):
        for p in range(len(bins)):
            ratio = (behind[p] - own[q, bins[p]]) * scale
            unlike[q, p] = min(max(ratio, np.float32(-1.0)), np.float32(1.0))
