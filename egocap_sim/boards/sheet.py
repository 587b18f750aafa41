"""The printed sheet of a board as a texture: paper, ink, and the fingers that hold it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.boards.board import Board

MARGIN = 0.06  # white border, as a share of the board's diagonal
_TEXEL_M = 1e-4
_MOST = 4000  # texels along the longer side
_INK, _PAPER = 0.045, 0.82  # linear reflectance
_PRINT = 0.02  # unevenness of both
_SKIN = ((0.42, 0.22, 0.14), (0.20, 0.10, 0.06), (0.58, 0.36, 0.26))


@dataclass(frozen=True, eq=False)
class Sheet:
    """Linear reflectance of a sheet. Texel (0, 0) is centred at `corner` + half a texel."""

    texture: Float[Array, "h w 3"]  # float32
    corner: tuple[float, float]  # of the sheet in the board frame, metres
    texel: float  # metres


def print_sheet(board: Board, rng: np.random.Generator) -> Sheet:
    """The sheet of a board held by two hands."""
    width, height = board.size
    margin = MARGIN * float(np.hypot(width, height))
    texel = max(_TEXEL_M, (max(width, height) + 2 * margin) / _MOST)
    shape = tuple(int(np.ceil((side + 2 * margin) / texel)) for side in (height, width))
    black = np.zeros(shape, np.float32)
    for x, y, w, h in (board.black() + [margin, margin, 0.0, 0.0]) / texel:
        columns, across = _coverage(x, x + w)
        rows, down = _coverage(y, y + h)
        black[rows, columns] += np.outer(down, across).astype(np.float32)
    grain = cv2.resize(
        rng.normal(size=(90, 90)).astype(np.float32), shape[::-1], interpolation=cv2.INTER_CUBIC
    )
    grey = (_PAPER + np.minimum(black, 1.0) * (_INK - _PAPER)) * (1 + _PRINT * grain)
    texture = np.repeat(grey[..., None], 3, 2)
    _hold(texture, margin / texel, rng)
    return Sheet(texture.clip(0.01, 1.0), (-margin, -margin), texel)


def _coverage(first: float, last: float) -> tuple[slice, Array]:
    """The texels that an interval touches, and the share of each that it covers."""
    a, b = int(np.floor(first + 1e-9)), int(np.ceil(last - 1e-9))
    edges = np.arange(a, b)
    return slice(a, b), np.minimum(edges + 1, last) - np.maximum(edges, first)


def _hold(texture: Array, margin: float, rng: np.random.Generator) -> None:
    """Paint a thumb and its nail at the left and at the right edge."""
    height, width, _ = texture.shape
    skin = np.array(_SKIN[int(rng.integers(len(_SKIN)))]) * rng.uniform(0.85, 1.1)
    for edge, inwards in ((0, 1), (width - 1, -1)):
        y = int(height * rng.uniform(0.35, 0.75))
        reach = margin * rng.uniform(0.7, 1.25)
        tip = (int(edge + inwards * reach), int(y - 0.4 * reach))
        thick = max(2, int(0.9 * margin))
        cv2.line(texture, (edge, y), tip, skin.tolist(), thick, cv2.LINE_AA)
        nail = (int(tip[0] + inwards * 0.1 * reach), tip[1])
        size = (max(1, int(0.22 * thick)), max(1, int(0.3 * thick)))
        cv2.ellipse(texture, nail, size, 60 * inwards, 0, 360, (1.25 * skin + 0.06).tolist(), -1,
                    cv2.LINE_AA)  # fmt: skip
