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
    return wrapped_noise(size, size, rows, columns, rng)


def wrapped_noise(
    height: int, width: int, rows: int, columns: int, rng: np.random.Generator
) -> Float[Array, "height width"]:
    """Smooth noise (float32) that tiles, about -1 to 1, in rows times columns of blobs."""
    grid = rng.uniform(-1.0, 1.0, (rows, columns)).astype(np.float32)
    return _stretch(_stretch(grid, height).T, width).T


def _stretch(grid: Array, size: int) -> Array:
    """Resample rows cyclically to `size` with a smooth step between neighbours."""
    at = np.arange(size) * len(grid) / size
    low = at.astype(int)
    share = at - low
    share = (share * share * (3 - 2 * share)).astype(np.float32)[:, None]
    here = grid[low]
    return here + (grid[(low + 1) % len(grid)] - here) * share
