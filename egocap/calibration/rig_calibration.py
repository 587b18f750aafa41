"""The whole calibration: lenses of all views, their poses on the rig, and the uncertainty."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.boards.board import Board, parse_board
from egocap.calibration.adjustment import Adjusted
from egocap.calibration.corner_search import refine_boards
from egocap.calibration.image_rim import rim_angle
from egocap.calibration.lens_shape import lens_shapes
from egocap.calibration.mount import place_on_head
from egocap.calibration.recording import Recording, View, read_recording
from egocap.calibration.state import Corners, State, by_view, joined
from egocap.calibration.stereo import SAME_INSTANTS, same_way_round, start_poses
from egocap.calibration.stereo import fixed_boards as fixed_board_poses
from egocap.calibration.timing import Clock, clock_of, require_small, with_timing
from egocap.calibration.view_calibration import (
    ViewCalibration,
    calibrate_view,
    start_camera,
    without_outliers,
)
from egocap.cameras.camera import Camera
from egocap.cameras.rig import Mount, Rig
from egocap.errors import InputError
from egocap.geometry import inverse

_MARGINS = (None, np.deg2rad(6.0), np.deg2rad(3.0), 0.0)
"""Of the field of view beyond the outermost corner, to try; None: to the image's corner."""
_TIMED = 3  # rounds, since lags and readout times change the velocities that they come from
Step = Callable[[str], None]
PLACED = "The cameras' place on the head is that of the nominal rig."
ASSUMED = (
    "The cameras' place on the head is assumed, since a board does not show the skull: measure it, "
    "or give the nominal rig as --mount."
)


@dataclass(frozen=True, eq=False)
class Calibration:
    """A calibrated rig with everything that its quality is judged by."""

    rig: Rig
    board: Board
    recording: Recording
    views: tuple[ViewCalibration, ...]
    adjusted: Adjusted  # of all views together
    corners: Corners
    notes: tuple[str, ...]  # what a reader of the rig file must know

    def deviations(self, view: int) -> dict[str, float]:
        """Standard deviation of each parameter of a view's lens, in the units of its file."""
        shape = self.adjusted.state.shapes[view]
        first = self.adjusted.state.lens_columns[view]
        own = np.sqrt(np.diag(self.adjusted.covariance)[first : first + len(shape.names)])
        return dict(zip(shape.names, map(float, own * shape.published_scale), strict=True))

    def pose_deviations(self, view: int) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
        """Standard deviations of T_view_rig: rotation [rad] and translation [m] along its axes."""
        first = int(self.adjusted.state.lens_columns[-1]) + 6 * (view - 1)
        own = np.sqrt(np.diag(self.adjusted.covariance)[first : first + 6])
        return own[:3], own[3:]

    def lag_deviations(self) -> Float[Array, "V-1"]:
        """Standard deviation of each view's lag but the first's, seconds."""
        state = self.adjusted.state
        return np.sqrt(np.diag(self.adjusted.covariance)[state.lag_column : state.readout_column])

    def readout_deviations(self) -> Float[Array, "V"]:
        """Standard deviation of each view's readout time, seconds."""
        state = self.adjusted.state
        return np.sqrt(np.diag(self.adjusted.covariance)[state.readout_column : state.own_column])


def calibrate(
    sources: Sequence[str | Path],
    board: str | Board,
    *,
    model: str | None = None,
    mount: Rig | None = None,
    name: str = "calibrated",
    fixed_boards: bool = False,
    lag: bool = False,
    readout: bool = False,
    on_step: Step = lambda what: None,
) -> Calibration:
    """Calibrate the cameras of a rig from pictures of a board.

    Args:
        sources: a folder of pictures per camera, of which those of the same name were taken
            together, or a video per camera, started together.
        board: as `egocap.boards.board.parse_board` reads it.
        model: lens model of all cameras; by default each one's is chosen by its held-out error.
        mount: a rig with the same views, on which the cameras' place on the head is taken from.
        name: of the rig.
        fixed_boards: each camera saw a board of its own, which stood still while the rig moved.
        lag: estimate how much later each camera exposes than the first, from videos.
        readout: estimate each rolling shutter's seconds from the first row to the last, likewise.
        on_step: called with a few words before each step.

    Raises InputError or FileError for pictures that do not determine the rig, with what to record
    instead.
    """
    board = parse_board(board) if isinstance(board, str) else board
    on_step("reading the pictures")
    return calibrate_recording(
        read_recording([Path(s) for s in sources], in_threes=lag or readout), board,
        model=model, mount=mount, name=name, fixed_boards=fixed_boards, lag=lag, readout=readout,
        on_step=on_step,
    )  # fmt: skip


def calibrate_recording(
    recording: Recording,
    board: Board,
    *,
    model: str | None = None,
    mount: Rig | None = None,
    name: str = "calibrated",
    fixed_boards: bool = False,
    lag: bool = False,
    readout: bool = False,
    on_step: Step = lambda what: None,
) -> Calibration:
    """`calibrate` for pictures in memory."""
    instants, views = len(recording.labels), []
    clock = clock_of(recording, lag=lag, readout=readout, fixed_boards=fixed_boards)
    for i, view in enumerate(recording.views):
        on_step(f"{view.name}: corners and lens")
        shapes = lens_shapes(model, view.size)
        views.append(calibrate_view(view, i, board, instants, shapes))
    adjusted, corners = views[0].adjusted, views[0].corners
    if len(views) > 1 or clock is not None:
        on_step("all cameras together")
        adjusted, corners = _together(views, board, fixed_boards, clock)
        _refuse_disagreement(adjusted, corners, [view.view.name for view in views])
    cameras = [_camera(adjusted.state, corners, v, view.view, board)
               for v, view in enumerate(views)]  # fmt: skip
    rig = _rig(adjusted.state, cameras, [v.view.name for v in views], mount, name)
    notes = (f"Calibrated from {board}.", PLACED if mount else ASSUMED)
    return Calibration(rig, board, recording, tuple(views), adjusted, corners, notes)


def _together(
    views: Sequence[ViewCalibration], board: Board, fixed: bool, clock: Clock | None
) -> tuple[Adjusted, Corners]:
    """Adjust all views; boards that one view missed are searched where the others place them.

    With a `clock`, lags and readout times as well.
    """
    if fixed:
        T_view_rig, own = fixed_board_poses(views, board)
    else:
        T_view_rig, own = start_poses(views, board), None
        views = same_way_round(views, T_view_rig, board)
    state = _joint_state(views, T_view_rig, own)
    every = joined([v.corners for v in views])
    adjusted, corners = without_outliers(state, every, board.points)
    if clock is not None:
        for _ in range(_TIMED):
            timed = with_timing(adjusted.state, every, clock)
            adjusted, corners = without_outliers(*timed, board.points)
        require_small(adjusted.state, clock.times)
        return adjusted, corners
    more = [corners]
    for v, view in enumerate(views):
        camera = start_camera(_alone(adjusted.state, v), view.view.size)
        known = set(map(int, corners.instant[corners.view == v]))
        missed = np.array(sorted(set(map(int, corners.instant)) - known), int)
        T = adjusted.state.T_view_rig[v] @ adjusted.state.boards(v, missed)
        poses = dict(zip(missed.tolist(), T, strict=True))
        more.append(refine_boards(view.view.pictures, poses, board, camera, v))
    if sum(map(len, more[1:])) == 0:
        return adjusted, corners
    return without_outliers(adjusted.state, joined(more), board.points)


def _refuse_disagreement(adjusted: Adjusted, corners: Corners, names: Sequence[str]) -> None:
    """Raise InputError where the pictures of several cameras contradict each other."""
    if len(names) == 1:
        return
    lost = [name for v, name in enumerate(names) if v not in corners.view]
    if lost:
        raise InputError(f"{', '.join(lost)}: no corner agrees with those of the other cameras",
                         valid=SAME_INSTANTS)  # fmt: skip
    if not adjusted.converged:
        raise InputError("the cameras' pictures agree on no poses of the cameras",
                         valid=SAME_INSTANTS)  # fmt: skip


def _joint_state(
    views: Sequence[ViewCalibration], T_view_rig: Float[Array, "V 4 4"],
    own: Float[Array, "V 4 4"] | None,
) -> State:  # fmt: skip
    """Lenses of all views, and each board's pose by the view that saw most of it."""
    first = views[0].adjusted.state.T_rig_board
    boards, most = np.tile(np.eye(4), (len(first), 1, 1)), np.zeros(len(first), int)
    for v, view in enumerate(views):
        count = np.bincount(view.corners.instant, minlength=len(first))
        better = count > most
        seen = inverse(T_view_rig[v]) @ view.adjusted.state.T_rig_board[better]
        boards[better] = seen if own is None else seen @ inverse(own[v])
        most = np.maximum(most, count)
    states = [view.adjusted.state for view in views]
    return State(tuple(s.shapes[0] for s in states), tuple(s.lenses[0] for s in states),
                 T_view_rig, boards, T_board_own=own)  # fmt: skip


def _alone(state: State, view: int) -> State:
    return replace(state, shapes=state.shapes[view : view + 1],
                   lenses=state.lenses[view : view + 1], T_view_rig=np.eye(4)[None],
                   T_board_own=None)  # fmt: skip


def _camera(state: State, corners: Corners, view: int, seen: View, board: Board) -> Camera:
    """The camera; its field ends where the image does, or where its polynomial turns back."""
    shape, lens = state.shapes[view], state.lenses[view]
    widest = _widest(state, corners, view, board)
    for margin in _MARGINS:
        limit = None if margin is None else min(widest + margin, np.pi)
        try:
            camera = shape.camera(lens, seen.size, limit)
        except InputError as error:
            problem = error
            continue
        return replace(camera, max_angle=rim_angle(seen.pictures, camera, widest))
    raise InputError(
        f"the fitted lens is impossible: {problem}",
        valid="the counts and sizes of the board as printed; a flat board",
    )


def _widest(state: State, corners: Corners, view: int, board: Board) -> float:
    """Angle off the axis of a view's outermost corner, radians."""
    own = corners[corners.view == view]
    points = next(by_view(state, own, board.points)).points
    return float(np.arctan2(np.hypot(points[:, 0], points[:, 1]), points[:, 2]).max())


def _rig(
    state: State, cameras: Sequence[Camera], names: Sequence[str], mount: Rig | None, name: str
) -> Rig:
    T_rig_view = inverse(state.T_view_rig)
    T_head_rig = place_on_head(T_rig_view, names, mount)
    mounts = [Mount(n, camera, T_head_rig @ T)
              for n, camera, T in zip(names, cameras, T_rig_view, strict=True)]  # fmt: skip
    return Rig(name, tuple(mounts), mount.frame_rate if mount else 30.0)
