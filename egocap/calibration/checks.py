"""What makes pictures useless for a calibration, and what to record instead."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from egocap.boards.board import Board
from egocap.calibration.detection import Anchors, anchor_points, find_markers
from egocap.calibration.planar_pose import homography_residual
from egocap.calibration.recording import View
from egocap.calibration.start import HALF_FIELDS, equidistant_rays, extent
from egocap.calibration.state import Corners
from egocap.errors import FileError, InputError

LEAST_BOARDS = 5  # pictures of a view
_TRIED = 12  # pictures searched for the reason
_LIES_FLAT = 0.06  # residual of a board's markers from the best homography, of their extent
RECORD = ("20 to 60 sharp pictures of the whole board, in even light, held still, near and tilted, "
          "all over the image out to its rim")  # fmt: skip


def refuse_no_boards(view: View, board: Board, anchors: Mapping[int, Anchors]) -> None:
    """Raise FileError with the likely reason if fewer than `LEAST_BOARDS` pictures show a board."""
    found = sum(len(a) > 0 for a in anchors.values())
    if found >= LEAST_BOARDS:
        return
    where = f"{board} is found in {found} of {len(anchors)} pictures"
    reason = _reason(view, board) if len(anchors) >= LEAST_BOARDS else None
    raise FileError(view.source, f"{where}{f': {reason}' if reason else ''}",
                    valid=f"{RECORD}; at least {LEAST_BOARDS} with the board")  # fmt: skip


def refuse_few_boards(view: View, corners: Corners) -> None:
    """Raise FileError if too few pictures have enough corners."""
    boards = len(np.unique(corners.instant))
    if boards < LEAST_BOARDS:
        raise FileError(view.source, f"the corners are clear in only {boards} of "
                        f"{len(view.pictures)} pictures", valid=RECORD)  # fmt: skip


def refuse_other_layout(view: View, board: Board, anchors: Mapping[int, Anchors]) -> None:
    """Raise FileError where the markers do not lie as on the board, whatever the lens.

    A board of other counts has the same markers at other places, which no lens explains.
    """
    if not board.markers or _layout_residual(board, anchors, view) < _LIES_FLAT:
        return
    found = {str(b): _layout_residual(b, anchors, view) for b in _other_boards(board)}
    best = min(found, key=lambda name: found[name])
    fits = found[best] < _LIES_FLAT
    raise FileError(view.source, f"no lens explains where the markers of {board} lie"
                    + (f": they lie as on {best}" if fits else ""),
                    valid="the counts and sizes of the board as printed; a flat board")  # fmt: skip


def _layout_residual(board: Board, anchors: Mapping[int, Anchors], view: View) -> float:
    """Median over pictures, with the equidistant lens that fits best; infinite without markers."""
    points, whole = anchor_points(board), sorted(anchors.values(), key=len)[-_TRIED:]
    shown = [a for a in whole if len(a) >= 8 and a.index.max() < len(points)]
    if not shown:
        return np.inf
    medians = []
    for half in HALF_FIELDS:
        rays = [equidistant_rays(a.pixels, view.size, view.size[0] / 2 / half) for a in shown]
        medians.append(np.median([homography_residual(r, points[a.index]) / extent(r)
                                  for r, a in zip(rays, shown, strict=True)]))  # fmt: skip
    return float(min(medians))


def _other_boards(board: Board) -> list[Board]:
    """The board turned, and boards of up to two squares more or less along a side."""
    found = [replace(board, columns=board.rows, rows=board.columns)]
    for columns in range(board.columns - 2, board.columns + 3):
        for rows in range(board.rows, board.rows + 4):  # rows beyond the printed ones do no harm
            try:
                found.append(replace(board, columns=columns, rows=rows))
            except InputError:
                continue
    return found


def _reason(view: View, board: Board) -> str | None:
    pictures = list(view.pictures.values())
    step = max(1, len(pictures) // _TRIED)
    tried = pictures[::step][:_TRIED]
    if board.markers:
        if any(len(find_markers(cv2.flip(p, 1), board)) >= 8 for p in tried):
            return "the pictures, or the print, are mirrored"
    else:
        for columns, rows in _other_grids(board):
            if sum(_has_grid(p, (columns, rows)) for p in tried) >= 2:
                return (f"they show {columns} x {rows} inner corners, a board of "
                        f"{columns + 1} x {rows + 1} squares")  # fmt: skip
    if np.median([cv2.Laplacian(p, cv2.CV_64F).var() for p in tried]) < 12.0:
        return "the pictures are blurred or empty"
    return None


def _has_grid(picture: UInt8[Array, "H W"], grid: tuple[int, int]) -> bool:
    return bool(cv2.findChessboardCornersSB(picture, grid)[0])


def _other_grids(board: Board) -> list[tuple[int, int]]:
    """Inner corners of boards that a user may have meant: counts of corners, one more or less."""
    columns, rows = board.grid
    steps = [(1, 1), (-1, -1), (1, 0), (0, 1), (-1, 0), (0, -1)]
    return [(columns + a, rows + b) for a, b in steps if min(columns + a, rows + b) >= 2]
