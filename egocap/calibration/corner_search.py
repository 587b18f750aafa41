"""Corners of the pictures of one view, given a lens: poses, missing boards, refined corners."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.boards.board import Board
from egocap.calibration.detection import NOTHING, Anchors, anchor_points, find_board
from egocap.calibration.patches import Refined, projector, refine, visible
from egocap.calibration.planar_pose import planar_pose
from egocap.calibration.state import Corners, joined, no_corners
from egocap.cameras.camera import Camera
from egocap.geometry import axis_angle

THREADS = 2
LEAST_REFINED = 6  # corners of a picture that count as a board
_LEAST_SHARE = 0.25  # of the corners in view
_RECTIFIED_PX, _RECTIFIED_FIELD = 800, np.deg2rad(78.0)
_TURNS = ((0.0, 0.0), *((np.deg2rad(62.0), k * np.pi / 4) for k in range(8)))
_SAME_BOARD = np.deg2rad(3.0)  # rms of the anchors' angles
_LEAST_WIDTH = 0.15  # of a set of corners, against its length
_FLOOR_PX = 0.005  # standard deviation of a perfect corner


def find_boards(pictures: Mapping[int, UInt8[Array, "H W"]], board: Board) -> dict[int, Anchors]:
    """First detection in every picture, in threads."""
    with ThreadPoolExecutor(THREADS) as pool:
        found = list(pool.map(lambda picture: find_board(picture, board), pictures.values()))
    return dict(zip(pictures, found, strict=True))


Maps = list[tuple[Float[Array, "h w"], Float[Array, "h w"]]]
"""For every pixel of rectified views the column and the row in the picture, float32."""


def rectified_maps(camera: Camera) -> Maps:
    """Pinhole views in nine directions, each without the lens's distortion."""
    axes = [np.array([-np.sin(azimuth), np.cos(azimuth), 0.0]) for _, azimuth in _TURNS]
    return [_pinhole_map(camera, axis_angle(axis, tilt))
            for axis, (tilt, _) in zip(axes, _TURNS, strict=True)]  # fmt: skip


def search_rectified(picture: UInt8[Array, "H W"], board: Board, maps: Maps) -> Anchors:
    """Look for a board in rectified views of a picture."""
    best = NOTHING
    for map_x, map_y in maps:
        found = find_board(cv2.remap(picture, map_x, map_y, cv2.INTER_CUBIC), board, quickly=True)
        if len(found) > len(best):
            at = found.pixels[:, None].astype(np.float32)
            back = [cv2.remap(m, at[..., 0], at[..., 1], cv2.INTER_LINEAR)[:, 0]
                    for m in (map_x, map_y)]  # fmt: skip
            best = Anchors(found.index, np.stack(back, -1).astype(float))
    return best


def anchor_pose(anchors: Anchors, board: Board, camera: Camera) -> Float[Array, "4 4"] | None:
    """T_camera_board of anchors, or None where they agree with no pose."""
    rays, valid = camera.ray(anchors.pixels)
    points = anchor_points(board)[anchors.index]
    if valid.sum() < 4:
        return None
    T, error = planar_pose(rays[valid], points[valid])
    return T if error < _SAME_BOARD else None


def refine_boards(
    pictures: Mapping[int, UInt8[Array, "H W"]],
    poses: Mapping[int, Float[Array, "4 4"]],
    board: Board,
    camera: Camera,
    view: int,
) -> Corners:
    """Refined corners of all pictures with a pose T_camera_board."""
    project = projector(camera)
    wanted = [i for i in poses if i in pictures]

    def search(i: int) -> Refined | None:
        seen = np.flatnonzero(visible(board, poses[i], project, (camera.width, camera.height)))
        if len(seen) < LEAST_REFINED:
            return None
        found = refine(pictures[i], board, poses[i], camera, seen)
        enough = max(LEAST_REFINED, _LEAST_SHARE * len(seen))
        whole = len(found.corner) >= enough and spans_plane(board.points[found.corner])
        return found if whole else None

    with ThreadPoolExecutor(THREADS) as pool:
        refined = list(pool.map(search, wanted))
    return joined([as_corners(found, i, view)
                   for i, found in zip(wanted, refined, strict=True) if found is not None]
                  or [no_corners()])  # fmt: skip


def spans_plane(points: Float[Array, "n 3"]) -> bool:
    """Whether points of a board determine its pose: they do not lie near one line."""
    along, across, _ = np.linalg.svd(points - points.mean(0), compute_uv=False)
    return bool(across > _LEAST_WIDTH * along)


def as_corners(found: Refined, instant: int, view: int) -> Corners:
    """The corners of a picture for the adjustment."""
    covariance = found.covariance + _FLOOR_PX**2 * np.eye(2)
    whitening = np.linalg.inv(np.linalg.cholesky(covariance))
    n = len(found.corner)
    return Corners(np.full(n, instant), np.full(n, view), found.corner, found.pixels, whitening)


def anchor_corners(anchors: Mapping[int, Anchors], view: int, least: int) -> Corners:
    """Anchors of pictures that have at least so many, for the first adjustment."""
    parts = [Corners(np.full(len(a), i), np.full(len(a), view), a.index, a.pixels,
                     np.tile(np.eye(2), (len(a), 1, 1)))
             for i, a in anchors.items() if len(a) >= least]  # fmt: skip
    return joined(parts or [no_corners()])


def _pinhole_map(camera: Camera, R_camera_view: Array) -> tuple[Array, Array]:
    """Pixels of the picture for every pixel of a rectified view."""
    focal = _RECTIFIED_PX / 2 / np.tan(_RECTIFIED_FIELD / 2)
    at = (np.arange(_RECTIFIED_PX) - (_RECTIFIED_PX - 1) / 2) / focal
    x, y = np.meshgrid(at, at)
    rays = np.stack([x, y, np.ones_like(x)], -1) @ R_camera_view.T
    pixels = projector(camera)(rays.reshape(-1, 3)).reshape(*x.shape, 2)
    pixels = np.nan_to_num(pixels, nan=-10.0).astype(np.float32)
    return pixels[..., 0], pixels[..., 1]
