"""Exposure times of image rows, and the weights of sub-frames in each row.

An image is a weighted mean of sub-frames rendered at instants spread evenly over the exposure. The
weights of a row are the overlaps of its own exposure with the sub-frames' time slots, which models
motion blur and rolling shutter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

_INSTANT = 1e-9  # seconds; a shorter exposure is a single instant


@dataclass(frozen=True, eq=False)
class Instants:
    """Times of the sub-frames of a frame, for all its views."""

    times: Float[Array, "N"]  # seconds
    slot: float  # seconds of the exposure that each represents


@dataclass(frozen=True, eq=False)
class Exposure:
    """Weights of the sub-frames in each row of one view's image."""

    times: Float[Array, "N"]  # seconds
    weights: Float[Array, "H N"]  # float32; rows sum to one
    nearest: Int[Array, "H"]  # the sub-frame nearest to the middle of each row's exposure

    def rows(self, i: int) -> slice:
        """The rows that use sub-frame `i`."""
        needed = np.flatnonzero((self.weights[:, i] > 0) | (self.nearest == i))
        return slice(int(needed[0]), int(needed[-1]) + 1) if len(needed) else slice(0, 0)


def row_time(
    middle: Float[Array, "*n"], rows: Float[Array, "*n"], height: int, readout_s: float
) -> Float[Array, "*n"]:
    """Middle of the exposure of rows [px] in an image whose middle row is exposed at `middle`."""
    return middle + ((rows + 0.5) / height - 0.5) * readout_s


def overlap_in_time(middle: Float[Array, "*n V"], span: float) -> Bool[Array, "*n"]:
    """Whether the exposures of the views overlap, so that they share their instants."""
    return np.ptp(middle, axis=-1) < span


def instants(middle: Float[Array, "V"], shutter_s: float, readout_s: float, count: int) -> Instants:
    """`count` instants over the exposure of the views; `count` for each view without overlap."""
    span = shutter_s + readout_s
    if overlap_in_time(middle, span):
        first, last = middle.min() - span / 2, middle.max() + span / 2
        slot = (last - first) / count
        return Instants(first + (np.arange(count) + 0.5) * slot, slot)
    slot = span / count
    within = ((np.arange(count) + 0.5) / count - 0.5) * span
    return Instants((np.unique(middle)[:, None] + within).ravel(), slot)


def exposure(
    middle: float, height: int, shutter_s: float, readout_s: float, rendered: Instants
) -> Exposure:
    """Weights of the instants in each row of a view of `height` rows."""
    times, slot = rendered.times, rendered.slot
    rows = row_time(np.full(height, middle), np.arange(height), height, readout_s)
    nearest = np.abs(rows[:, None] - times).argmin(1)
    if shutter_s < _INSTANT:
        weights = np.eye(len(times))[nearest]
    else:
        begin = np.maximum(rows[:, None] - shutter_s / 2, times - slot / 2)
        end = np.minimum(rows[:, None] + shutter_s / 2, times + slot / 2)
        weights = np.maximum(end - begin, 0.0)
        weights /= weights.sum(1, keepdims=True)
    return Exposure(times, weights.astype(np.float32), nearest)
