"""First detection of a board in a picture, before the lens is known, by OpenCV's detectors.

What is found are anchors: points of the board with their pixels, to a fraction of a pixel or some.
They start the calibration; `egocap.calibration.patches` measures the corners themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray as Array

from egocap.boards.board import TAG_BORDER, Board

Grey = UInt8[Array, "H W"]
Attempt = Callable[[Grey, tuple[int, int]], Array | None]

_WINDOWS = (3, 43, 8)  # of the adaptive threshold: smallest, largest, step; pixels
_ENLARGED = 1_000_000  # pixels of the largest picture that is enlarged: it takes seconds
_SMALL = 640  # longer side of the picture in which a checkerboard is first looked for


@dataclass(frozen=True, eq=False)
class Anchors:
    """Points of a board seen in one picture."""

    index: Int[Array, "n"]  # of `anchor_points`
    pixels: Float[Array, "n 2"]

    def __len__(self) -> int:
        return len(self.index)


NOTHING = Anchors(np.zeros(0, int), np.zeros((0, 2)))


def anchor_points(board: Board) -> Float[Array, "M 3"]:
    """All points that may be anchors: corners of a checkerboard, of the markers of other boards."""
    if not board.markers:
        return board.points
    flat = np.concatenate(list(board.markers.values()))
    return np.column_stack([flat, np.zeros(len(flat))])


def find_board(picture: Grey, board: Board, *, quickly: bool = False) -> Anchors:
    """Find a board in a picture; `quickly` by the first detector of a checkerboard alone."""
    if board.markers:
        return find_markers(picture, board)
    return find_checkerboard(picture, board.grid, _ATTEMPTS[:1] if quickly else _ATTEMPTS)


def find_markers(picture: Grey, board: Board) -> Anchors:
    """Find the markers of a ChArUco board or AprilGrid; few ones also in an enlarged picture."""
    found = _markers(picture, board)
    if len(found) >= 2 * len(board.markers):  # half of them, four corners each
        return found
    large = cv2.resize(picture, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_CUBIC)
    again = _markers(large, board)
    if len(again) <= len(found):
        return found
    return Anchors(again.index, (again.pixels + 0.5) / 2.0 - 0.5)


def _markers(picture: Grey, board: Board) -> Anchors:
    corners, numbers, _ = _marker_detector(board).detectMarkers(picture)
    numbers = np.zeros(0, int) if numbers is None else np.ravel(numbers)
    unique = [i for i, n in enumerate(numbers)
              if n < len(board.markers) and (numbers == n).sum() == 1]  # fmt: skip
    if not unique:
        return NOTHING
    index = 4 * numbers[unique][:, None] + np.arange(4)
    pixels = np.concatenate([np.reshape(corners[i], (4, 2)) for i in unique]).astype(float)
    found = Anchors(index.ravel(), pixels)
    return _way_round(found, board) if board.kind == "aprilgrid" else found


def _way_round(found: Anchors, board: Board) -> Anchors:
    """Tags read as Kalibr prints them, or as OpenCV draws them, which is half a turn apart.

    Each tag says in which direction its nearest neighbour lies; the majority decides, for Kalibr's
    print where nothing tells. Directions near a tag hold for every lens.
    """
    points = anchor_points(board)[found.index, :2].reshape(-1, 4, 2)
    pixels = found.pixels.reshape(-1, 4, 2)
    middle, centre = points.mean(1), pixels.mean(1)
    apart = np.linalg.norm(middle - middle[:, None], axis=2)
    np.fill_diagonal(apart, np.inf)
    nearest = apart.argmin(1)
    axes = np.einsum("nci,ncj->nij", pixels - centre[:, None], points - middle[:, None])
    expected = np.einsum("nij,nj->ni", axes, middle[nearest] - middle)
    votes = np.sign(np.sum(expected * (centre[nearest] - centre), axis=1))
    if votes.sum() > 0:
        return found
    return Anchors(found.index // 4 * 4 + (found.index % 4 + 2) % 4, found.pixels)


@cache
def _marker_detector(board: Board) -> cv2.aruco.ArucoDetector:
    settings = cv2.aruco.DetectorParameters()
    settings.adaptiveThreshWinSizeMin, settings.adaptiveThreshWinSizeMax = _WINDOWS[:2]
    settings.adaptiveThreshWinSizeStep = _WINDOWS[2]
    settings.minMarkerPerimeterRate = 0.012
    settings.polygonalApproxAccuracyRate = 0.05  # edges are curved
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    settings.cornerRefinementWinSize = 3
    settings.markerBorderBits = TAG_BORDER if board.kind == "aprilgrid" else 1
    return cv2.aruco.ArucoDetector(board.cv_dictionary, settings)


def find_checkerboard(picture: Grey, grid: tuple[int, int], attempts: Sequence[Attempt]) -> Anchors:
    """Find all inner corners of a checkerboard; half a turn of the board is not told apart.

    The first corner is one whose quadrant right of and below it, in the board's frame, is black.
    """
    for attempt in attempts:
        pixels = attempt(picture, grid)
        if pixels is not None:
            return Anchors(np.arange(len(pixels)), _oriented(picture, pixels, grid))
    return NOTHING


def _sector_based(picture: Grey, grid: tuple[int, int]) -> Array | None:
    """The detector of Duda and Frese 2018."""
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY
    cv2.setRNGSeed(0)  # the detector draws random numbers
    found, corners = cv2.findChessboardCornersSB(picture, grid, flags=flags)
    return corners.reshape(-1, 2).astype(float) if found else None


def _quads(picture: Grey, grid: tuple[int, int]) -> Array | None:
    """The detector by black quadrangles, in a small picture."""
    scale = min(1.0, _SMALL / max(picture.shape))
    small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
    found, corners = cv2.findChessboardCorners(small, grid, flags=flags)
    if not found:
        return None
    pixels = (corners.reshape(-1, 2).astype(float) + 0.5) / scale - 0.5
    return _snapped(picture, pixels, grid)


def _enlarged(picture: Grey, grid: tuple[int, int]) -> Array | None:
    """The sector-based detector in a small picture of twice the size and even contrast."""
    if picture.size > _ENLARGED:
        return None
    even = cv2.createCLAHE(3.0, (8, 8)).apply(picture)
    large = cv2.resize(even, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_CUBIC)
    corners = _sector_based(large, grid)
    return None if corners is None else (corners + 0.5) / 2.0 - 0.5


_ATTEMPTS: tuple[Attempt, ...] = (_sector_based, _quads, _enlarged)


def _snapped(picture: Grey, pixels: Array, grid: tuple[int, int]) -> Array:
    """Corners moved to the nearest saddle points, in windows that hold one corner each."""
    mesh = pixels.reshape(grid[1], grid[0], 2)
    apart = min(np.linalg.norm(np.diff(mesh, axis=a), axis=-1).min() for a in (0, 1))
    window = int(np.clip(0.35 * apart, 2, 9))
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.01)
    start = pixels.astype(np.float32).reshape(-1, 1, 2)
    return cv2.cornerSubPix(picture, start, (window, window), (-1, -1), stop).reshape(-1, 2)


def _oriented(picture: Grey, pixels: Array, grid: tuple[int, int]) -> Float[Array, "n 2"]:
    """The corners in the board's order: not mirrored, the first square before them black."""
    mesh = right_handed(pixels.reshape(grid[1], grid[0], 2))
    return (mesh if first_is_black(picture, mesh) else mesh[::-1, ::-1]).reshape(-1, 2)


def right_handed(mesh: Float[Array, "r c 2"]) -> Float[Array, "r c 2"]:
    """The corners of a board seen from its front: not mirrored."""
    across, down = mesh[0, -1] - mesh[0, 0], mesh[-1, 0] - mesh[0, 0]
    return mesh[:, ::-1] if across[0] * down[1] - across[1] * down[0] < 0 else mesh


def first_is_black(picture: Grey, mesh: Float[Array, "r c 2"]) -> bool:
    """Whether squares of the first one's colour, between four corners, are the darker ones."""
    middle = (mesh[:-1, :-1] + mesh[1:, :-1] + mesh[:-1, 1:] + mesh[1:, 1:]) / 4
    at = np.clip(np.rint(middle).astype(int), 0, np.array(picture.shape)[::-1] - 1)
    grey = picture[at[..., 1], at[..., 0]].astype(float)
    rows, columns = np.indices(grey.shape)
    even = (rows + columns) % 2 == 0
    return bool(grey[even].mean() < grey[~even].mean())
