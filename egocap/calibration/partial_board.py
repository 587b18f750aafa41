"""Checkerboards of which a picture shows a part: cut off by the image, covered, or washed out.

The part is found as a lattice of corners of any size. It may lie anywhere on the board; taken is
the place at which the picture shows most of the corners and of the white border that it should,
given the lens. Corners alone tell little: those that are covered are missing at the right place,
and as many beyond the board's end at a wrong one. The part is refused where another place is
nearly as good.
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
_SAME_PX = 2.0  # between corners of the same place
_CLEARLY = 4  # corners and parts of the border by which the best place surpasses all others
_BORDER = 0.35  # squares from the board's edge to where its white border is looked for
_WHITE = 0.6  # least grey value of it, between those of black and white squares


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
    shown = [_shown(picture, board, camera, part) for part in _places(mesh, black, board)]
    placed = [(score + _border(picture, board, camera, part), part)
              for score, part in shown if score > 0]  # fmt: skip
    if not placed:
        return NOTHING
    score, best = max(placed, key=lambda found: found[0])
    others = [other for other, part in placed if not _same(part, best)]
    return best if all(score >= other + _CLEARLY for other in others) else NOTHING


def _same(a: Anchors, b: Anchors) -> bool:
    """Whether two sets agree on most of the corners that both have."""
    both, at, of = np.intersect1d(a.index, b.index, return_indices=True)
    apart = np.linalg.norm(a.pixels[at] - b.pixels[of], axis=1)
    return len(both) > 0 and bool(np.median(apart) < _SAME_PX)


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


def _border(picture: Grey, board: Board, camera: Camera, part: Anchors) -> int:
    """Places just outside the board that are white, less those that are not."""
    T, _ = planar_pose(camera.ray(part.pixels)[0], board.points[part.index])
    columns, rows = board.grid
    cells = np.stack([part.index % columns + 1, part.index // columns + 1], -1)  # after each corner
    grey = _greys(picture, camera, T, board.square * (cells + 0.5))
    black = cells.sum(1) % 2 == 0
    along = [np.arange(n + 1) + 0.5 for n in (columns, rows)]
    ends = [np.array([-_BORDER, n + 1 + _BORDER]) for n in (columns, rows)]
    sides = (along[0], ends[1]), (ends[0], along[1])
    places = np.concatenate([np.stack(np.meshgrid(*side), -1).reshape(-1, 2) for side in sides])
    seen = _greys(picture, camera, T, board.square * places)
    if not (black.any() and (~black).any()):
        return 0
    dark, bright = np.nanmedian(grey[black]), np.nanmedian(grey[~black])
    white = seen > dark + _WHITE * (bright - dark)
    return int(2 * white.sum() - np.isfinite(seen).sum())


def _greys(
    picture: Grey, camera: Camera, T: Float[Array, "4 4"], places: Float[Array, "n 2"]
) -> Float[Array, "n"]:
    """Grey values of places on the board [m], NaN out of view."""
    seen = places @ T[:3, :2].T + T[:3, 3]
    pixels = projector(camera)(seen)
    with np.errstate(invalid="ignore"):
        inside = np.all((pixels >= 0) & (pixels < [camera.width, camera.height]), axis=1)
    at = np.rint(np.where(inside[:, None], pixels, 0.0)).astype(int)
    at = np.minimum(at, [camera.width - 1, camera.height - 1])
    return np.where(inside, picture[at[:, 1], at[:, 0]].astype(float), np.nan)
