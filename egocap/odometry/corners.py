"""Corners spread over a picture: the best of every cell that holds none yet.

Source: minimum eigenvalue of the structure tensor, Shi and Tomasi 1994.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

CELL = 20  # px
BORDER = 6  # px
FAINTEST = 1e-6
"""Smallest eigenvalue of a corner (OpenCV's scale, pictures of 8 bits: at most about 0.1)."""


def find_corners(
    image: UInt8[Array, "H W"], mask: UInt8[Array, "H W"], taken: Float[Array, "n 2"], most: int
) -> Float[Array, "m 2"]:
    """Up to `most` new corners (u, v) where `mask` is not 0, the strongest first."""
    import cv2

    strength = cv2.cornerMinEigenVal(image, 5, ksize=3)
    strength[mask == 0] = 0.0
    strength[:BORDER] = strength[-BORDER:] = 0.0
    strength[:, :BORDER] = strength[:, -BORDER:] = 0.0
    rows, columns = image.shape[0] // CELL, image.shape[1] // CELL
    cells = strength[: rows * CELL, : columns * CELL].reshape(rows, CELL, columns, CELL)
    cells = cells.transpose(0, 2, 1, 3).reshape(rows * columns, CELL * CELL)
    best = cells.argmax(1)
    height = cells[np.arange(len(cells)), best]
    cell = (taken // CELL).astype(int)
    inside = (cell[:, 0] < columns) & (cell[:, 1] < rows)
    height[cell[inside, 1] * columns + cell[inside, 0]] = 0.0
    order = np.argsort(-height, kind="stable")[:most]
    order = order[height[order] > FAINTEST]
    v = (order // columns) * CELL + best[order] // CELL
    u = (order % columns) * CELL + best[order] % CELL
    found = np.stack([u, v], -1).astype(float)
    return found[_alone(found, taken)]


def _alone(found: Float[Array, "m 2"], taken: Float[Array, "n 2"]) -> Array:
    """Corners at least half a cell away from those that are taken."""
    if not len(taken) or not len(found):
        return np.ones(len(found), bool)
    apart = np.square(found[:, None] - taken[None]).sum(-1).min(1)
    return apart >= (0.5 * CELL) ** 2
