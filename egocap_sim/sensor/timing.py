"""When each row of a picture gathers light, and of which sub-frames it is put together.

A picture is a mean of sub-frames rendered at instants spread evenly over the time in which its
sensor gathers light. A row's weights are the overlaps of its own exposure with the sub-frames' time
slots: motion blur is their mean, rolling shutter that rows differ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array

from egocap_sim.sensor.light import decode

_INSTANT = 1e-9  # seconds; a shutter faster than this sees one instant


@dataclass(frozen=True, eq=False)
class Exposure:
    """One view's picture: the instants to render, and each row's share of them."""

    times: Float[Array, "N"]  # seconds
    weights: Float[Array, "H N"]  # float32; rows sum to one
    nearest: Int[Array, "H"]  # the sub-frame nearest to the middle of each row's exposure


def row_time(
    middle: Float[Array, "*n"], rows: Float[Array, "*n"], height: int, readout_s: float
) -> Float[Array, "*n"]:
    """Middle of the exposure of rows [px] in a picture whose middle row is exposed at `middle`."""
    return middle + ((rows + 0.5) / height - 0.5) * readout_s


def exposure(
    middle: float, height: int, shutter_s: float, readout_s: float, count: int
) -> Exposure:
    """Instants and weights of a picture of `height` rows put together of `count` sub-frames."""
    span = shutter_s + readout_s
    slot = span / count
    times = middle + ((np.arange(count) + 0.5) / count - 0.5) * span
    rows = row_time(np.full(height, middle), np.arange(height), height, readout_s)
    nearest = np.abs(rows[:, None] - times).argmin(1)
    if shutter_s < _INSTANT:
        weights = np.eye(count)[nearest]
    else:
        begin = np.maximum(rows[:, None] - shutter_s / 2, times - slot / 2)
        end = np.minimum(rows[:, None] + shutter_s / 2, times + slot / 2)
        weights = np.maximum(end - begin, 0.0)
        weights /= weights.sum(1, keepdims=True)
    return Exposure(times, weights.astype(np.float32), nearest)


def add_subframe(
    picture: Float[Array, "H W 3"], subframe: UInt8[Array, "H W 3"], weight: Float[Array, "H"]
) -> None:
    """Add a rendered sub-frame to the rows of a picture in linear light, by each row's weight."""
    rows = np.flatnonzero(weight)
    if len(rows):
        band = slice(rows[0], rows[-1] + 1)
        picture[band] += weight[band, None, None] * decode(subframe[band])


def add_rows(plane: Array, subframe: Array, rows: Bool[Array, "H"]) -> None:
    """Labels and depth cannot be averaged: take the rows whose nearest sub-frame this is."""
    plane[rows] = subframe[rows]
