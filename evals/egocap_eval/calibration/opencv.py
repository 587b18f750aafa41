"""OpenCV's fisheye and omnidirectional calibration on the corners that ours has found.

Every reprojection error is the root mean square of a coordinate, in pixels, over the same corners
with equal weights. Boards beyond 88 degrees off the axis are left out: cv2.fisheye cannot project
them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy import ndarray as Array

from egocap.calibration.adjustment import adjust
from egocap.calibration.lens_shape import LensShape
from egocap.calibration.model_choice import with_shape
from egocap.calibration.rig_calibration import Calibration
from egocap.calibration.state import Corners, State

KANNALA = LensShape("kannala_brandt")
_FARTHEST = np.deg2rad(88.0)
_DIVERGED_PX = 10.0
_STOP = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-9)


def compare(calibration: Calibration, view: int) -> dict[str, float | int | None]:
    """Errors on the corners of one view; None where OpenCV raises or diverges.

    `fisheye` starts from its own guess, `fisheye_guided` from our lens; `ours_fisheye` is our
    least squares with the same model. `omnidir` leaves out boards that it cannot start;
    `ours_omnidir` is ours with the chosen model on the boards that it used.
    """
    corners, state = _view(calibration, view)
    points, size = calibration.board.points, calibration.views[view].view.size
    objects, images = _boards(corners, points)
    K, guess = _matrix(calibration, view), cv2.CALIB_USE_INTRINSIC_GUESS
    omnidir, used = _omnidir(objects, images, size)
    shared = corners[np.isin(corners.instant, np.unique(corners.instant)[used])]
    same = with_shape(state, KANNALA, points)
    return {
        "boards": len(objects),
        "ours_fisheye": adjust(same, corners, points, huber=np.inf).rms,
        "fisheye": _tried(lambda: _fisheye(objects, images, size, K, 0)),
        "fisheye_guided": _tried(lambda: _fisheye(objects, images, size, K, guess)),
        "ours_omnidir": adjust(state, shared, points, huber=np.inf).rms if used else None,
        "omnidir": omnidir,
        "omnidir_boards": len(used),
    }


def _fisheye(objects: list[Array], images: list[Array], size: Any, K: Array, flags: int) -> float:
    flags |= cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW
    rms = cv2.fisheye.calibrate(objects, images, size, K.copy(), np.zeros((4, 1)), flags=flags)[0]
    return rms / np.sqrt(2.0)  # theirs counts points


def _omnidir(
    objects: list[Array], images: list[Array], size: Any
) -> tuple[float | None, list[int]]:
    """Its error, and the boards that it used."""
    used: list[int] = []

    def run() -> float:
        found = cv2.omnidir.calibrate(objects, images, size, None, None, None, 0, _STOP)  # type: ignore[call-overload]
        _, K, xi, D, turns, shifts, rows = found
        squares = []
        for row, turn, shift in zip(np.ravel(rows).tolist(), turns, shifts, strict=True):
            seen = cv2.omnidir.projectPoints(objects[row], turn, shift, K, float(xi.ravel()[0]), D)
            squares.append((seen[0].reshape(-1, 2) - images[row][0]) ** 2)
            used.append(row)
        return float(np.sqrt(np.concatenate(squares).mean()))

    return _tried(run), used


def _tried(run: Callable[[], float]) -> float | None:
    try:
        rms = float(run())
    except cv2.error:
        return None
    return rms if rms < _DIVERGED_PX else None


def _view(calibration: Calibration, view: int) -> tuple[Corners, State]:
    """The corners of one view on boards in front of it, equally weighted, and its state alone."""
    corners, state = calibration.corners, calibration.adjusted.state
    poses = state.T_view_rig[view] @ state.T_rig_board
    seen = np.einsum("nij,nj->ni", poses[corners.instant][:, :3, :3],
                     calibration.board.points[corners.corner])  # fmt: skip
    seen += poses[corners.instant][:, :3, 3]
    theta = np.arctan2(np.hypot(seen[:, 0], seen[:, 1]), seen[:, 2])
    far = np.unique(corners.instant[(theta > _FARTHEST) & (corners.view == view)])
    own = corners[(corners.view == view) & ~np.isin(corners.instant, far)]
    even = np.tile(np.eye(2), (len(own), 1, 1))
    alone = State((state.shapes[view],), (state.lenses[view],), np.eye(4)[None], poses)
    return replace(own, view=np.zeros(len(own), int), whitening=even), alone


def _boards(corners: Corners, points: Array) -> tuple[list[Array], list[Array]]:
    groups = [np.flatnonzero(corners.instant == i) for i in np.unique(corners.instant)]
    return ([points[corners.corner[at]][None] for at in groups],
            [corners.pixels[at][None] for at in groups])  # fmt: skip


def _matrix(calibration: Calibration, view: int) -> Array:
    camera = calibration.rig.cameras[view]
    focal = np.sqrt(np.linalg.det(np.array(camera.affine))) * camera.radial.radius(0.0)[1]
    return np.array([[focal, 0, camera.centre[0]], [0, focal, camera.centre[1]], [0, 0, 1.0]])
