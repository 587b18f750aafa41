"""What makes pictures useless for a calibration, and what to record instead."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from egocap.boards.board import Board, parse_board
from egocap.calibration.detection import Anchors, anchor_points, find_markers
from egocap.calibration.planar_pose import homography_residual
from egocap.calibration.recording import View
from egocap.calibration.start import HALF_FIELDS, equidistant_rays, extent
from egocap.calibration.state import Corners
from egocap.errors import FileError, InputError

LEAST_BOARDS = 5  # pictures of a view
_TRIED = 12  # pictures searched for the reason
_MORE_ROWS = 4
_LIES_FLAT = 0.06  # residual of a board's markers from the best homography, of their extent
MIRRORED = "the pictures, or the print, are mirrored"
RECORD = "20 to 60 sharp pictures, held still, near and tilted, all over the image to its rim"


def refuse_no_boards(view: View, board: Board, anchors: Mapping[int, Anchors]) -> None:
    """Raise FileError with the likely reason if fewer than `LEAST_BOARDS` pictures show a board."""
    found = sum(len(a) > 0 for a in anchors.values())
    if found >= LEAST_BOARDS:
        return
    where = f"{board} is found in {found} of {len(anchors)} pictures"
    reason = _reason(view, board) if len(anchors) >= LEAST_BOARDS else None
    raise FileError(view.source, f"{where}{f': {reason}' if reason else ''}",
                    valid=f"{RECORD}; at least {LEAST_BOARDS} with the board")  # fmt: skip


def refuse_few_boards(view: View, board: Board, corners: Corners) -> None:
    """Raise FileError with the likely reason if too few pictures have enough corners."""
    boards = len(np.unique(corners.instant))
    if boards >= LEAST_BOARDS:
        return
    reason = None if board.markers else _other_counts(view, board)
    raise FileError(view.source, f"the corners of {board} are clear in only {boards} of "
                    f"{len(view.pictures)} pictures{f': {reason}' if reason else ''}",
                    valid=RECORD)  # fmt: skip


def refuse_other_layout(view: View, board: Board, anchors: Mapping[int, Anchors]) -> None:
    """Raise FileError where the markers do not lie as on the board, whatever the lens.

    A board of other counts has the same markers at other places, which no lens explains.
    """
    if not board.markers or _layout_residual(board, anchors, view) < _LIES_FLAT:
        return
    if _mirrored(view, board):
        raise FileError(view.source, MIRRORED, valid="pictures as the camera takes them, of a "
                        "board printed as it is")  # fmt: skip
    found = {str(b): _layout_residual(b, anchors, view) for b in _other_boards(board)}
    best = min(found, key=lambda name: found[name])
    fits = found[best] < _LIES_FLAT
    best = str(_with_all_rows(view, parse_board(best))) if fits else best
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
    tried = _tried(view)
    if board.markers:
        if _mirrored(view, board):
            return MIRRORED
    elif other := _other_counts(view, board):
        return other
    if np.median([cv2.Laplacian(p, cv2.CV_64F).var() for p in tried]) < 12.0:
        return "the pictures are blurred or empty"
    return None


def _other_counts(view: View, board: Board) -> str | None:
    """The counts that the pictures show instead of a checkerboard's, in words.

    A part of a larger board looks like a smaller one, so that larger ones are tried first, and
    smaller ones only where the board itself is nowhere.
    """
    own = any(_has_grid(p, board.grid) for p in _tried(view))
    for grid in sorted(_other_grids(board), key=np.prod, reverse=True):
        if own and np.prod(grid) < np.prod(board.grid):
            return None
        if sum(_has_grid(p, grid) for p in _tried(view)) >= 2:
            columns, rows = grid
            return (f"they show {columns} x {rows} inner corners, a board of {columns + 1} x "
                    f"{rows + 1} squares")  # fmt: skip
    return None


def _with_all_rows(view: View, board: Board) -> Board:
    """The board with as many rows as the markers that are seen need."""
    most = replace(board, rows=min(board.rows + _MORE_ROWS, board.most_rows))
    seen = np.concatenate([np.unique(find_markers(p, most).index // 4) for p in _tried(view)])
    markers, times = np.unique(seen, return_counts=True)
    last = int(markers[times >= 2].max(initial=0))
    rows = range(3, most.rows + 1)
    enough = [r for r in rows if len(replace(board, rows=r).markers) > last]
    return replace(board, rows=enough[0]) if enough else board


def _tried(view: View) -> list[UInt8[Array, "H W"]]:
    pictures = list(view.pictures.values())
    return pictures[:: max(1, len(pictures) // _TRIED)][:_TRIED]


def _mirrored(view: View, board: Board) -> bool:
    """Whether more markers are found in mirrored pictures, and enough for a board."""
    as_is, flipped = (
        [len(find_markers(p, board)) for p in pictures]
        for pictures in (_tried(view), [cv2.flip(p, 1) for p in _tried(view)])
    )
    return max(flipped) >= 8 and sum(flipped) > sum(as_is)


def _has_grid(picture: UInt8[Array, "H W"], grid: tuple[int, int]) -> bool:
    return bool(cv2.findChessboardCornersSB(picture, grid)[0])


def _other_grids(board: Board) -> list[tuple[int, int]]:
    """Inner corners of boards that a user may have meant: counts of corners, one more or less."""
    columns, rows = board.grid
    steps = [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if (a, b) != (0, 0)]
    return [(columns + a, rows + b) for a, b in steps if min(columns + a, rows + b) >= 2]
