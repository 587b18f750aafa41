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
    columns = values.reshape(len(values), -1).T
    found = np.stack([np.interp(at, times, column) for column in columns], -1)
    return found.reshape(*np.shape(at), *values.shape[1:])


def runs(numbers: Int[Array, "n"], gap: int = 1) -> Iterator[Int[Array, "m"]]:
    """Split ascending numbers where they rise by more than `gap`; nothing if there are none."""
    if len(numbers):
        yield from np.split(numbers, np.flatnonzero(np.diff(numbers) > gap) + 1)
