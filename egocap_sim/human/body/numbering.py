"""Small whole numbers, each once and in order."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int
from numpy import ndarray as Array


def distinct(numbers: Int[Array, "N"]) -> tuple[Int[Array, "M"], Int[Array, "N"]]:
    """Where each number is met first, in their order, and for every entry the place of its number.

    As `numpy.unique`, without sorting; it takes memory for numbers up to the largest.
    """
    first = np.full(numbers.max(initial=-1) + 1, -1)
    first[numbers[::-1]] = np.arange(len(numbers))[::-1]
    met = first >= 0
    return first[met], (np.cumsum(met) - 1)[numbers]
