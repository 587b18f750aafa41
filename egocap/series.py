"""Values sampled over time: interpolation, and runs of consecutive numbers."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array


def interpolate(
    at: Float[Array, "*n"] | float, times: Float[Array, "T"], values: Float[Array, "T *rest"]
) -> Float[Array, "*n *rest"]:
    """Linear interpolation of samples at ascending `times`; beyond the ends their values hold."""
    # To the bit what numpy.interp gives, of all columns at once.
    wanted, columns = np.ravel(at), np.asarray(values, float).reshape(len(values), -1)
    before = np.maximum(np.searchsorted(times, wanted, side="right") - 1, 0)
    after = np.minimum(before + 1, len(times) - 1)
    away = np.maximum(wanted - times[before], 0.0)[:, None]
    step = np.where(after > before, times[after] - times[before], np.inf)[:, None]
    low = columns[before]
    found = np.where(away == 0.0, low, (columns[after] - low) / step * away + low)
    return found.reshape(*np.shape(at), *values.shape[1:])


def nearest(times: Float[Array, "N"], wanted: Float[Array, "T"]) -> Int[Array, "T"]:
    """Places in ascending `times`, one or more, nearest to those wanted; of two the earlier."""
    after = np.clip(np.searchsorted(times, wanted), 1, max(len(times) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(times) - 1)
    return np.where(wanted - times[before] <= times[after] - wanted, before, after)


def runs(numbers: Int[Array, "n"], gap: int = 1) -> Iterator[Int[Array, "m"]]:
    """Split ascending numbers where they rise by more than `gap`; nothing if there are none."""
    if len(numbers):
        yield from np.split(numbers, np.flatnonzero(np.diff(numbers) > gap) + 1)
