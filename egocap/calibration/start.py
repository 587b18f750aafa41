"""Starting values without a guess: an equidistant lens and the board poses."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from egocap.calibration.adjustment import Adjusted, adjust
from egocap.calibration.lens_shape import LensShape
from egocap.calibration.planar_pose import homography_residual, planar_pose
from egocap.calibration.state import Corners, State

HALF_FIELDS = np.deg2rad([25, 33, 42, 52, 64, 78, 92, 108, 125, 145])  # over half the width
_STARTS = 3  # best focal lengths that are adjusted
EQUIDISTANT = LensShape("equidistant")


def start_view(corners: Corners, points: Float[Array, "K 3"], size: tuple[int, int]) -> Adjusted:
    """Adjust an equidistant lens and the poses of the boards it saw; corners are of one view.

    Several focal lengths are tried; the one with the lowest robust residual is kept.
    """
    boards = boards_of(corners)
    errors = []
    for half in HALF_FIELDS:
        rays = equidistant_rays(corners.pixels, size, size[0] / 2 / half)
        # a homography fits rays of the wrong focal length worse; relative to the board's extent
        each = [homography_residual(rays[b], points[corners.corner[b]]) / extent(rays[b])
                for b in boards]  # fmt: skip
        errors.append(float(np.median(each)))
    best = sorted(zip(errors, HALF_FIELDS, strict=True))[:_STARTS]
    found = [_adjusted(corners, points, size, half) for _, half in best]
    return min(found, key=lambda a: float(np.median(np.abs(a.residuals))))


def boards_of(corners: Corners) -> list[Int[Array, "_"]]:
    """Indices of the corners of each instant, in order of the instants that have any."""
    return [np.flatnonzero(corners.instant == i) for i in np.unique(corners.instant)]


def equidistant_rays(
    pixels: Float[Array, "N 2"], size: tuple[int, int], focal: float
) -> Float[Array, "N 3"]:
    """Unit rays of pixels for an equidistant lens about the middle of the image."""
    flat = (pixels - (np.array(size) - 1) / 2) / focal
    theta = np.linalg.norm(flat, axis=1)
    return np.column_stack([flat * np.sinc(theta / np.pi)[:, None], np.cos(theta)])


def board_poses(
    rays: Float[Array, "N 3"], corners: Corners, points: Float[Array, "K 3"]
) -> Float[Array, "I 4 4"]:
    """T_camera_board of every instant up to the last; the identity where too few corners are."""
    T = np.tile(np.eye(4), (int(corners.instant.max(initial=-1)) + 1, 1, 1))
    for b in boards_of(corners):
        if len(b) >= 4:
            T[corners.instant[b[0]]] = planar_pose(rays[b], points[corners.corner[b]])[0]
    return T


def _adjusted(corners: Corners, points: Array, size: tuple[int, int], half: float) -> Adjusted:
    focal = size[0] / 2 / half
    poses = board_poses(equidistant_rays(corners.pixels, size, focal), corners, points)
    lens = np.array([(size[0] - 1) / 2, (size[1] - 1) / 2, focal, focal])
    state = State((EQUIDISTANT,), (lens,), np.eye(4)[None], poses)
    return adjust(state, corners, points)


def extent(rays: Float[Array, "n 3"]) -> float:
    """Root mean square distance of unit rays from their mean."""
    return float(np.sqrt(((rays - rays.mean(0)) ** 2).sum(1).mean())) + 1e-9
