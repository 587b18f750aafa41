"""Where in a view the wearer is: cells in which corners keep being rejected.

In: corners and whether each was rejected (too near, or moving otherwise than the surroundings).
Out: the cells to leave out. The wearer's body hardly leaves its part of a head-fixed picture.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

CELL = 20  # px
MEMORY = 60.0  # corners after which a cell's history has faded
MOST = 0.7  # rejected share from which a cell is left out
_PRIOR = 6.0  # corners that a cell starts with, none of them rejected


class RejectionMap:
    """Fading counts of accepted and rejected corners in cells of a picture."""

    def __init__(self, width: int, height: int) -> None:
        self._size = height, width
        shape = -(-height // CELL), -(-width // CELL)
        self._rejected, self._all = np.zeros(shape), np.full(shape, _PRIOR)

    def add(self, pixels: Float[Array, "n 2"], rejected: Bool[Array, "n"]) -> None:
        """Count corners."""
        u, v = np.clip(pixels // CELL, 0, np.array(self._all.shape)[::-1] - 1).astype(int).T
        np.add.at(self._all, (v, u), 1.0)
        np.add.at(self._rejected, (v, u), rejected.astype(float))
        fade = np.minimum(1.0, MEMORY / self._all)
        self._all *= fade
        self._rejected *= fade

    @property
    def rejected(self) -> Bool[Array, "H W"]:
        """Pixels to leave out."""
        cells = self._rejected > MOST * self._all
        pixels = cells.repeat(CELL, 0).repeat(CELL, 1)
        return pixels[: self._size[0], : self._size[1]]
