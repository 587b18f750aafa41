"""The lens of one camera: from its pictures to refined corners, a lens model and board poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.boards.board import Board
from egocap.calibration.adjustment import (
    Adjusted,
    adjust,
    robust_scale,
    whitened,
)
from egocap.calibration.checks import (
    refuse_few_boards,
    refuse_no_boards,
    refuse_other_layout,
)
from egocap.calibration.corner_search import (
    LEAST_REFINED,
    anchor_corners,
    anchor_pose,
    find_boards,
    rectified_maps,
    refine_boards,
    search_rectified,
)
from egocap.calibration.detection import NOTHING, Anchors, anchor_points
from egocap.calibration.lens_shape import LensShape
from egocap.calibration.model_choice import Choice, choose_shape, with_shape
from egocap.calibration.partial_board import find_part
from egocap.calibration.planar_pose import planar_pose
from egocap.calibration.recording import View
from egocap.calibration.start import start_view
from egocap.calibration.state import Corners, State
from egocap.cameras.camera import Camera
from egocap.errors import InputError

OUTLIER = 5.0  # standard deviations of a whitened residual's length
_FLEXIBLE = LensShape("kannala_brandt")
_ROUNDS = 2  # of refining corners and adjusting
_FEW = 0.5  # of a board's anchors: fewer make the picture worth a second search


@dataclass(frozen=True, eq=False)
class ViewCalibration:
    """A calibrated camera and what it was calibrated from."""

    view: View
    index: int
    choice: Choice
    adjusted: Adjusted  # of this view alone
    corners: Corners

    @property
    def poses(self) -> dict[int, Float[Array, "4 4"]]:
        """T_camera_board of the instants with corners."""
        boards = self.adjusted.state.T_rig_board
        return {int(i): boards[i] for i in np.unique(self.corners.instant)}


def calibrate_view(
    view: View, index: int, board: Board, instants: int, shapes: Sequence[LensShape]
) -> ViewCalibration:
    """Calibrate one camera. Raises InputError where the pictures do not determine it."""
    anchors = find_boards(view.pictures, board)
    refuse_no_boards(view, board, anchors)
    refuse_other_layout(view, board, anchors)
    least = 8 if board.markers else LEAST_REFINED
    first = anchor_corners(anchors, 0, least)
    refuse_few_boards(view, board, first)
    started = start_view(first, anchor_points(board), view.size)
    poses = _anchor_poses(view, board, anchors, start_camera(started.state, view.size))
    adjusted, corners = _refined(view, board, started, poses, instants)
    choice = choose_shape(adjusted, corners, board.points, shapes)
    state = with_shape(adjusted.state, choice.shape, board.points)
    adjusted, corners = without_outliers(state, corners, board.points)
    return ViewCalibration(
        view, index, choice, adjusted, replace(corners, view=corners.view + index)
    )


def start_camera(state: State, size: tuple[int, int]) -> Camera:
    """The camera of a single view's state, for searching."""
    return state.shapes[0].camera(state.lenses[0], size)


def without_outliers(
    state: State, corners: Corners, points: Float[Array, "K 3"]
) -> tuple[Adjusted, Corners]:
    """Adjust, drop corners beyond `OUTLIER`, and pictures left with too few; repeat while any."""
    while True:
        adjusted = adjust(state, corners, points)
        white = whitened(adjusted.residuals, corners)
        kept = np.linalg.norm(white, axis=1) < OUTLIER * robust_scale(white)
        count = np.zeros((int(corners.view.max()) + 1, len(state.T_rig_board)), int)
        np.add.at(count, (corners.view[kept], corners.instant[kept]), 1)
        kept &= count[corners.view, corners.instant] >= LEAST_REFINED
        if kept.all():
            return adjusted, corners
        state, corners = adjusted.state, corners[kept]
        if not len(corners):
            raise InputError("the corners agree with no lens", valid="sharp pictures of the board")


def _anchor_poses(
    view: View, board: Board, anchors: Mapping[int, Anchors], camera: Camera
) -> dict[int, Float[Array, "4 4"]]:
    """Poses from anchors; pictures with few are searched again in rectified views."""
    poses, maps = {}, rectified_maps(camera)
    for i, found in anchors.items():
        if len(found) < _FEW * len(anchor_points(board)):
            again = NOTHING if board.markers else find_part(view.pictures[i], board, camera)
            again = again if len(again) else search_rectified(view.pictures[i], board, maps)
            found = again if len(again) > len(found) else found
        T = anchor_pose(found, board, camera)
        if T is not None:
            poses[i] = T
    return poses


def _refined(
    view: View, board: Board, started: Adjusted, poses: Mapping[int, Array], instants: int
) -> tuple[Adjusted, Corners]:
    """Refine corners and adjust a flexible lens, in turns."""
    camera = start_camera(started.state, view.size)
    lens = started.state
    for _ in range(_ROUNDS):
        corners = refine_boards(view.pictures, poses, board, camera, 0)
        refuse_few_boards(view, board, corners)
        state = _state(lens, camera, corners, board, instants)
        adjusted, corners = without_outliers(state, corners, board.points)
        lens = adjusted.state
        camera = start_camera(lens, view.size)
        poses = {i: lens.T_rig_board[i] for i in map(int, np.unique(corners.instant))} | {
            i: T for i, T in poses.items() if i not in corners.instant
        }
    return adjusted, corners


def _state(lens: State, camera: Camera, corners: Corners, board: Board, instants: int) -> State:
    """A flexible lens like the one known, with the poses of the refined corners."""
    T = np.tile(np.eye(4), (instants, 1, 1))
    rays, _ = camera.ray(corners.pixels)
    for i in np.unique(corners.instant):
        at = corners.instant == i
        T[i] = planar_pose(rays[at], board.points[corners.corner[at]])[0]
    state = State(lens.shapes, lens.lenses, np.eye(4)[None], T)
    return with_shape(state, _FLEXIBLE, board.points)
