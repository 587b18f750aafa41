"""A board as a PDF for the printer, at true scale, with a ruler to check the print."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from egocap.boards.board import Board
from egocap.errors import InputError
from egocap.files import replacing

MARGIN_M = 0.012  # white border, which detectors need
RULER_M = 0.1
_INCH = 0.0254
_PAPERS = {"A4": (0.210, 0.297), "A3": (0.297, 0.420), "A2": (0.420, 0.594), "A1": (0.594, 0.841),
           "A0": (0.841, 1.189)}  # fmt: skip
_STRIP_M = 0.016  # for the ruler and the description


def print_board(board: Board, path: Path) -> str:
    """Write a PDF of the board at true scale and return the name of the paper.

    The page is the smallest of A4 to A0 that holds the board, or fits the board if none does. A
    ruler of 100 mm stands below it. Raises InputError unless `path` ends in .pdf, and as
    `egocap.files.disk_errors`.
    """
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure

    if path.suffix.lower() != ".pdf":
        raise InputError(f"cannot write '{path.name}'", valid="a name that ends in .pdf")
    name, (width, height) = _paper(board)
    figure = Figure(figsize=(width / _INCH, height / _INCH))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.set(xlim=(0.0, width), ylim=(height, 0.0))  # metres of paper, y down
    left, top = (width - board.size[0]) / 2, (height - _STRIP_M - board.size[1]) / 2
    boxes = board.black() + np.array([left, top, 0.0, 0.0])
    shapes = [[(x, y), (x + w, y), (x + w, y + h), (x, y + h)] for x, y, w, h in boxes]
    # thin strokes of the fill's colour would widen the squares; without, seams may show on screen
    axes.add_collection(PolyCollection(shapes, facecolors="black", edgecolors="none"))
    _ruler(axes, left, height - _STRIP_M, board)
    with replacing(path, keep_suffix=True) as temporary:
        figure.savefig(temporary, metadata={"CreationDate": None})
    return name


def _paper(board: Board) -> tuple[str, tuple[float, float]]:
    """Name and size of the page: the smallest standard one, turned as the board."""
    width, height = (side + 2 * MARGIN_M for side in board.size)
    height += _STRIP_M
    for name, (short, long) in _PAPERS.items():
        for page in ((short, long), (long, short)):
            if width <= page[0] and height <= page[1]:
                return name, page
    return "a page of its own size", (width, height)


def _ruler(axes, left: float, y: float, board: Board) -> None:  # type: ignore[no-untyped-def]
    length = RULER_M if board.size[0] >= RULER_M else 0.02
    axes.plot([left, left + length], [y, y], color="black", linewidth=0.8)
    for i in range(11):
        x = left + length * i / 10
        axes.plot([x, x], [y, y + 0.003], color="black", linewidth=0.8)
    text = (f"{1000 * length:g} mm: measure it; if it differs, the print was scaled.   "
            f"--board {board}")  # fmt: skip
    axes.text(left, y + 0.009, text, fontsize=7, family="monospace")
