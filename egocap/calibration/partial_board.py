"""Checkerboards of which a picture shows a part: cut off by the image, covered, or washed out.

The part is found as a lattice of corners of any size. It may lie anywhere on the board; taken is
the place at which the picture shows most of the corners that it should, given the lens.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.boards.board import Board
from egocap.calibration.detection import NOTHING, Anchors, Grey, first_is_black, right_handed
from egocap.calibration.patches import projector, refine, visible
from egocap.calibration.planar_pose import planar_pose
from egocap.cameras.camera import Camera

_LEAST = (3, 3)  # corners of a lattice
_SIDE = 2  # corners along the shorter side of a part of it
_BEND = np.deg2rad(0.25)  # rms error of the angles of a part without false corners
_SMALL = 0.6  # scale of a reduced picture
_FEWEST = 6  # corners of a part
_GROWTH = 3  # rounds of refining the pose and looking for more corners


def find_part(picture: Grey, board: Board, camera: Camera) -> Anchors:
    """Find a part of a checkerboard; nothing where no place on the board explains it best."""
    for clearer, scale in _attempts(picture):
        lattice = _lattice(clearer)
        mesh = None if lattice is None else _flat_part((lattice + 0.5) / scale - 0.5, camera)
        found = NOTHING if mesh is None else _placed(picture, board, camera, mesh)
        if len(found):
            return found
    return NOTHING


def _attempts(picture: Grey) -> Iterator[tuple[Grey, float]]:
    """The picture, also reduced, with even contrast and without noise, and the scale of each."""
    even = cv2.createCLAHE(3.0, (8, 8))
    small = cv2.resize(picture, None, fx=_SMALL, fy=_SMALL, interpolation=cv2.INTER_AREA)
    yield small, _SMALL
    yield picture, 1.0
    yield even.apply(small), _SMALL
    yield even.apply(picture), 1.0
    yield cv2.GaussianBlur(picture, (0, 0), 1.5), 1.0


def _placed(picture: Grey, board: Board, camera: Camera, mesh: Float[Array, "a b 2"]) -> Anchors:
    """The corners of a board that has a lattice at the place where most of them are shown."""
    black = first_is_black(picture, mesh)
    placed = [_shown(picture, board, camera, part) for part in _places(mesh, black, board)]
    placed.sort(key=lambda found: found[0], reverse=True)
    if not placed or placed[0][0] < 1 or (len(placed) > 1 and placed[1][0] == placed[0][0]):
        return NOTHING
    return placed[0][1]


def _flat_part(mesh: Float[Array, "r c 2"], camera: Camera) -> Float[Array, "a b 2"] | None:
    """The largest part of a lattice that a flat board explains: its rim holds false corners."""
    rays, valid = camera.ray(mesh)
    blocks = sorted(
        ((high * wide, row, column, high, wide)
         for high in range(_SIDE, len(mesh) + 1)
         for wide in range(_SIDE + (high == _SIDE), mesh.shape[1] + 1)
         for row in range(len(mesh) - high + 1) for column in range(mesh.shape[1] - wide + 1)),
        reverse=True,
    )  # fmt: skip
    for _, row, column, high, wide in blocks:
        at = slice(row, row + high), slice(column, column + wide)
        if valid[at].all():
            points = np.indices((wide, high, 1)).reshape(3, -1, order="F").T.astype(float)
            if planar_pose(rays[at].reshape(-1, 3), points)[1] < _BEND:
                return right_handed(mesh[at])
    return None


def _lattice(picture: Grey) -> Float[Array, "r c 2"] | None:
    """The largest lattice of corners."""
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_LARGER
    cv2.setRNGSeed(0)  # the detector draws random numbers
    found, corners, meta = cv2.findChessboardCornersSBWithMeta(picture, _LEAST, flags)
    if not found:
        return None
    return corners.reshape(*meta.shape[:2], 2).astype(float)


def _places(mesh: Float[Array, "r c 2"], black: bool, board: Board) -> Iterator[Anchors]:
    """Anchors of the lattice at every place on the board where its squares' colours agree.

    `black`: whether the square after the first corner has the colour of the board's. Places that
    half a turn of the board carries into another are given once.
    """
    columns, rows = board.grid
    for turns in range(2 if board.symmetric else 4):
        turned = np.rot90(mesh, turns)
        high, wide = turned.shape[:2]
        odd = (0 if black else 1) + _odd_after(mesh.shape[:2], turns)
        for row in range(rows - high + 1):
            for column in range(columns - wide + 1):
                if (row + column + odd) % 2 == 0:
                    at = (row + np.arange(high))[:, None] * columns + column + np.arange(wide)
                    yield Anchors(at.ravel(), turned.reshape(-1, 2))


def _odd_after(shape: tuple[int, int], turns: int) -> int:
    """Parity of the square that comes first after quarter turns, against the first one."""
    squares = np.add.outer(np.arange(shape[0] - 1), np.arange(shape[1] - 1)) % 2
    return int(np.rot90(squares, turns)[0, 0])


def _shown(picture: Grey, board: Board, camera: Camera, part: Anchors) -> tuple[int, Anchors]:
    """Corners in view that look like corners less those that do not, and the former.

    Corners next to those known are found first, those farther away with the pose of all of them.
    """
    best = -len(board.points), part
    for _ in range(_GROWTH):
        index, pixels = best[1].index, best[1].pixels
        T, _ = planar_pose(camera.ray(pixels)[0], board.points[index])
        seen = np.flatnonzero(visible(board, T, projector(camera), (camera.width, camera.height)))
        if len(seen) < _FEWEST:
            break
        found = refine(picture, board, T, camera, seen)
        score = 2 * len(found.corner) - len(seen)
        if len(found.corner) < _FEWEST or score <= best[0]:
            break
        best = score, Anchors(found.corner, found.pixels)
    return best
