"""Sub-pixel corners in locally rectified patches.

Each corner's surroundings are sampled on the board's own plane, through the lens and the board's
pose, so that the corner looks as if seen from the front however oblique the view. The point at
which the patch's gradients are orthogonal to the lines to it starts the fit of two edges to the
pixels themselves.

Source: Foerstner and Guelch 1987; Geiger et al. 2012 and Schoeps et al. 2020 for refinement in
rectified patches; `egocap.calibration.saddle_fit`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array

from egocap.boards.board import Board
from egocap.calibration.saddle_fit import Surroundings, fit_saddles
from egocap.cameras.camera import Camera

Project = Callable[[Array], Array]
"""Pixels (N, 2) of points (N, 3) in the camera frame; NaN outside the lens's field."""

_HALF = 10  # samples from the corner to the border of its patch
_MOST_PX = 8.0  # half the side of a patch, in pixels of its wider direction
_LEAST_PX = 2.0  # in its wider direction
_ROUNDS = 5
_SHARE = 0.85  # of the free surroundings that a patch uses
_LEAST_SCORE = 0.75  # correlation with a corner
_LEAST_CONTRAST = 12.0  # grey levels between black and white
_MOST_MOVE = 0.35  # from the predicted place, as a share of the patch's half side
_AROUND_PX = 10  # from a corner to the border of the pixels that are fitted
_LEAST_FREE = 0.15  # of half a side: surroundings that count as free of markers
_BLUR_PX = 0.3  # of a marker's edge, that is left out


@dataclass(frozen=True, eq=False)
class Refined:
    """Corners of one picture."""

    corner: Int[Array, "n"]
    pixels: Float[Array, "n 2"]
    covariance: Float[Array, "n 2 2"]  # pixels^2


def refine(
    picture: UInt8[Array, "H W"],
    board: Board,
    T_camera_board: Float[Array, "4 4"],
    camera: Camera,
    wanted: Int[Array, "n"],
) -> Refined:
    """Refine the `wanted` corners of a board; those that do not look like corners are left out."""
    project = projector(camera)
    points = board.points[wanted]
    half = _half_sizes(points, board, T_camera_board, project)
    inside = np.isfinite(half)
    wanted, points, half = wanted[inside], points[inside], half[inside]
    offset = np.zeros((len(wanted), 2))
    grid = np.stack(np.meshgrid(*[np.arange(-_HALF, _HALF + 1) / _HALF] * 2), -1)
    good = np.ones(len(wanted), bool)
    weight = _window(grid, board, half)
    for _ in range(_ROUNDS):
        pixels = _pixels(
            points, (offset[:, None, None] + grid) * _wide(half), T_camera_board, project
        )
        patch = _sampled(picture, pixels)
        complete = np.all(np.isfinite(patch), axis=(1, 2))
        good &= complete
        patch = np.where(complete[:, None, None], patch, 0.0)
        step = _foerstner(patch, grid, weight)
        offset += np.clip(step, -0.3, 0.3)
        if np.abs(step[good]).max(initial=0.0) < 1e-3:
            break
    score = _score(patch, grid, weight, board.polarity[wanted])
    good &= (np.abs(offset).max(1) < _MOST_MOVE) & (score > _LEAST_SCORE)
    wanted, points, half, offset = wanted[good], points[good], half[good], offset[good]
    J = _patch_jacobian(half, points, T_camera_board, project)
    seen = _surroundings(picture, board, points, half, T_camera_board, camera, J)
    offset, covariance = fit_saddles(seen, offset)
    at = _pixels(points, offset[:, None, None] * _wide(half), T_camera_board, project)[:, 0, 0]
    near = (np.abs(offset) < _MOST_MOVE).all(1) & np.isfinite(at).all(1)
    return Refined(wanted[near], at[near], (J @ covariance @ J.swapaxes(1, 2))[near])


def projector(camera: Camera) -> Project:
    """Pixels of points in the camera frame, NaN outside the field of view."""

    def project(points: Float[Array, "N 3"]) -> Float[Array, "N 2"]:
        pixels, _ = camera.project(points)
        rho = np.hypot(points[:, 0], points[:, 1])
        inside = np.arctan2(rho, points[:, 2]) <= camera.max_angle
        return np.where(inside[:, None], pixels, np.nan)

    return project


def _wide(half: Float[Array, "n"]) -> Float[Array, "n 1 1 1"]:
    return half[:, None, None, None]


def _surroundings(
    picture: Array, board: Board, points: Array, half: Float[Array, "n"],
    T_camera_board: Float[Array, "4 4"], camera: Camera, J: Float[Array, "n 2 2"],
) -> Surroundings:  # fmt: skip
    """The pixels around corners, and where on the board their rays meet it."""
    side = np.arange(-_AROUND_PX, _AROUND_PX + 1)
    middle = _pixels(points, np.zeros((len(points), 1, 1, 2)), T_camera_board, projector(camera))
    pixels = np.rint(middle[:, 0]) + np.stack(np.meshgrid(side, side), -1).reshape(-1, 2)
    inside = np.all((pixels >= 0) & (pixels < [camera.width, camera.height]), axis=-1)
    at = np.where(inside[..., None], pixels, 0).astype(int)
    rays, _ = camera.ray(at)
    R, t = T_camera_board[:3, :3], T_camera_board[:3, 3]
    towards = rays @ R[:, 2]
    inside &= towards * (t @ R[:, 2]) > 1e-9
    distance = t @ R[:, 2] / np.where(inside, towards, 1.0)
    flat = (rays * distance[..., None] - t) @ R[:, :2]
    u = (flat - points[:, None, :2]) / half[:, None, None]
    pixel = np.linalg.norm(np.linalg.inv(J), axis=2)
    free = np.maximum(board.reach / half[:, None] - _BLUR_PX * pixel, _LEAST_FREE)
    clear = (np.abs(u) < free[:, None]).any(-1) & (np.abs(u) < 1.0).all(-1) & inside
    weight = np.where(clear, np.exp(-2.0 * np.minimum(u**2, 1.0).sum(-1)), 0.0)
    return Surroundings(picture[at[..., 1], at[..., 0]].astype(float), u, weight, pixel)


def _half_sizes(points: Array, board: Board, T: Array, project: Project) -> Float[Array, "n"]:
    """Half the side of each patch in metres; NaN where the corner is out of view or too small."""
    reach = _SHARE * board.edge_reach
    px = _scale_px(np.full(len(points), reach), points, T, project)
    with np.errstate(invalid="ignore"):
        return np.where(px >= _LEAST_PX, reach * np.minimum(1.0, _MOST_PX / px), np.nan)


def _scale_px(half: Array, points: Array, T: Array, project: Project) -> Float[Array, "n"]:
    """Length of half a patch's side in pixels, in its wider direction."""
    return np.linalg.norm(_patch_jacobian(half, points, T, project), axis=1).max(1)


def _patch_jacobian(
    half: Array, points: Array, T: Array, project: Project
) -> Float[Array, "n 2 2"]:
    """Pixels by the coordinates of the patch, whose unit is half its side."""
    steps = np.array([[[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]])
    at = _pixels(points, steps * _wide(half), T, project)[:, 0]
    return np.stack([at[:, 0] - at[:, 1], at[:, 2] - at[:, 3]], -1) / 2


def _pixels(points: Array, flat: Array, T: Array, project: Project) -> Float[Array, "n a b 2"]:
    """Pixels of places on the board at `flat` metres (n, a, b, 2) from the corners."""
    shape = np.broadcast_shapes(flat.shape[:-1], (len(points), 1, 1))
    places = np.zeros((*shape, 3))
    places[..., :2] = flat
    places += points[:, None, None]
    seen = places.reshape(-1, 3) @ T[:3, :3].T + T[:3, 3]
    return project(seen).reshape(*shape, 2)


def _sampled(picture: Array, pixels: Float[Array, "n a b 2"]) -> Float[Array, "n a b"]:
    """Grey values, NaN outside the picture."""
    height, width = picture.shape
    with np.errstate(invalid="ignore"):
        inside = np.all((pixels >= 0) & (pixels <= [width - 1, height - 1]), axis=-1)
    at = np.where(inside[..., None], pixels, 0.0).astype(np.float32)
    wide = at.reshape(len(at), -1, 2)
    values = cv2.remap(picture, wide[..., 0], wide[..., 1], cv2.INTER_LINEAR).reshape(inside.shape)
    return np.where(inside, values, np.nan)


def _window(grid: Array, board: Board, half: Float[Array, "n"]) -> Float[Array, "n a a"]:
    """Weights of the samples: a bell about the corner, zero where a marker may lie."""
    bell = np.exp(-2.0 * (grid**2).sum(-1))
    free = board.reach * _SHARE / half  # of the diagonal surroundings, in the patch's unit
    nearest = np.abs(grid).min(-1)
    return bell * (nearest < np.maximum(free, _LEAST_FREE)[:, None, None])


def _foerstner(patch: Float[Array, "n a a"], grid: Array, weight: Array) -> Float[Array, "n 2"]:
    """The point to which the gradients are orthogonal, in the patch's unit."""
    gy, gx = np.gradient(patch, axis=(1, 2))
    w = weight[:, 1:-1, 1:-1]
    gx, gy, at = gx[:, 1:-1, 1:-1], gy[:, 1:-1, 1:-1], grid[1:-1, 1:-1]
    along = gx * at[..., 0] + gy * at[..., 1]
    gradient = np.stack([gx, gy], -1)
    A = np.einsum("nab,nabi,nabj->nij", w, gradient, gradient)
    b = np.einsum("nab,nabi,nab->ni", w, gradient, along)
    A += 1e-6 * (np.trace(A, axis1=1, axis2=2)[:, None, None] + 1e-6) * np.eye(2)
    return np.linalg.solve(A, b[..., None])[..., 0]


def _score(
    patch: Array, grid: Array, weight: Array, polarity: Int[Array, "n"]
) -> Float[Array, "n"]:
    """Correlation with an ideal corner of the right polarity; 0 without contrast."""
    ideal = -np.sign(grid[..., 0] * grid[..., 1]) * polarity[:, None, None]
    w = weight * (ideal != 0)
    w = w / w.sum((1, 2), keepdims=True)
    dark = patch - (w * patch).sum((1, 2), keepdims=True)
    ideal = ideal - (w * ideal).sum((1, 2), keepdims=True)
    deviation = np.sqrt((w * dark**2).sum((1, 2)))
    correlation = (w * dark * ideal).sum((1, 2)) / np.maximum(
        deviation * np.sqrt((w * ideal**2).sum((1, 2))), 1e-9
    )
    return np.where(2 * deviation > _LEAST_CONTRAST, correlation, 0.0)


def visible(
    board: Board, T_camera_board: Float[Array, "4 4"], project: Project, size: tuple[int, int]
) -> Bool[Array, "K"]:
    """Corners that lie in the image on the board's front."""
    seen = board.points @ T_camera_board[:3, :3].T + T_camera_board[:3, 3]
    pixels = project(seen)
    with np.errstate(invalid="ignore"):
        inside = ((pixels > 1) & (pixels < np.array(size) - 2)).all(1)
    return inside & (seen @ T_camera_board[:3, 2] > 0)
