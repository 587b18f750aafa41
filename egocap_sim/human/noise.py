"""Seamless noise for textures."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array


def smooth_noise(
    size: int, cells: int | tuple[int, int], rng: np.random.Generator
) -> Float[Array, "size size"]:
    """Smooth noise that tiles, about -1 to 1, with so many blobs (rows, columns) a side."""
    rows, columns = (cells, cells) if isinstance(cells, int) else cells
    grid = rng.uniform(-1.0, 1.0, (rows, columns))
    return _stretch(_stretch(grid, size).T, size).T


def _stretch(grid: Array, size: int) -> Array:
    """Resample rows cyclically to `size` with a smooth step between neighbours."""
    at = np.arange(size) * len(grid) / size
    low = at.astype(int)
    share = at - low
    share = (share * share * (3 - 2 * share))[:, None]
    return grid[low] * (1 - share) + grid[(low + 1) % len(grid)] * share
