"""Seamless noise for textures."""

from __future__ import annotations

import numba
import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array


def smooth_noise(
    size: int, cells: int | tuple[int, int], rng: np.random.Generator
) -> Float[Array, "size size"]:
    """Square seamless noise, about -1 to 1, from a grid of `cells` (rows, columns)."""
    rows, columns = (cells, cells) if isinstance(cells, int) else cells
    return wrapped_noise(size, size, rows, columns, rng)


def wrapped_noise(
    height: int, width: int, rows: int, columns: int, rng: np.random.Generator
) -> Float[Array, "height width"]:
    """Seamless noise (float32), about -1 to 1, interpolated from a grid of rows and columns."""
    grid = rng.uniform(-1.0, 1.0, (rows, columns)).astype(np.float32)
    return stretched(grid, *_smooth_steps(height, rows), *_smooth_steps(width, columns))


def _smooth_steps(size: int, cells: int) -> tuple[Int[Array, "size"], Float[Array, "size"]]:
    """The cell before each of `size` pixels, and the smooth-step weight of the next one."""
    at = np.arange(size) * cells / size
    low = at.astype(int)
    share = at - low
    return low, (share * share * (3 - 2 * share)).astype(np.float32)


@numba.njit(cache=True)
def stretched(
    grid: Float[Array, "h w"],
    row: Int[Array, "height"],
    down: Float[Array, "height"],
    column: Int[Array, "width"],
    across: Float[Array, "width"],
) -> Float[Array, "height width"]:
    """Bilinear enlargement of a periodic grid (float32).

    `row` and `column` are the cells before a pixel, `down` and `across` the weights of the next.
    """
    rows, columns = grid.shape
    wide = np.empty((rows + 1, len(column)), np.float32)
    for y in range(rows):
        for x in range(len(column)):
            here, after = grid[y, column[x]], grid[y, (column[x] + 1) % columns]
            wide[y, x] = here + (after - here) * across[x]
    wide[rows] = wide[0]
    image = np.empty((len(row), len(column)), np.float32)
    for y in range(len(row)):
        above, below, share = wide[row[y]], wide[row[y] + 1], down[y]
        for x in range(len(column)):
            image[y, x] = above[x] + (below[x] - above[x]) * share
    return image
