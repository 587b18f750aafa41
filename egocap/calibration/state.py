"""The unknowns of a calibration, the corners that determine them, and the derivatives.

Unknowns common to all pictures: each view's lens; T_view_rig of each view but the first, whose
frame is the rig's; optionally the lag of each view but the first, the readout time of each view, or
the place of the board of its own that each view but the first sees. Unknowns of each instant:
T_rig_board.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy.spatial.transform import Rotation

from egocap.calibration.lens_shape import LensShape
from egocap.calibration.planar_pose import moved_pose
from egocap.geometry import skew


@dataclass(frozen=True, eq=False)
class Corners:
    """N observed corners."""

    instant: Int[Array, "N"]  # index of the board pose
    view: Int[Array, "N"]
    corner: Int[Array, "N"]  # index of the board's corner
    pixels: Float[Array, "N 2"]
    whitening: Float[Array, "N 2 2"]  # maps a residual [px] to unit covariance, but for a factor

    def __len__(self) -> int:
        return len(self.instant)

    def __getitem__(self, kept: Bool[Array, "N"]) -> Corners:
        return Corners(*(getattr(self, name)[kept] for name in _FIELDS))


_FIELDS = ("instant", "view", "corner", "pixels", "whitening")


def joined(parts: list[Corners]) -> Corners:
    """All corners of several sets."""
    return Corners(*(np.concatenate([getattr(p, name) for p in parts]) for name in _FIELDS))


def no_corners() -> Corners:
    """An empty set."""
    none = np.zeros(0, int)
    return Corners(none, none, none, np.zeros((0, 2)), np.zeros((0, 2, 2)))


@dataclass(frozen=True, eq=False)
class Timing:
    """What lags and readout times refer to."""

    heights: tuple[int, ...] = ()  # of the pictures, for a rolling shutter
    velocity: Float[Array, "I 6"] | None = None  # rotation [rad/s] and translation [m/s]
    acceleration: Float[Array, "I 6"] | None = None  # of the same, a second


GLOBAL = Timing()
"""A global shutter, and cameras that expose at the same instant."""


@dataclass(frozen=True, eq=False)
class State:
    """Values of the unknowns."""

    shapes: tuple[LensShape, ...]
    lenses: tuple[Float[Array, "L"], ...]
    T_view_rig: Float[Array, "V 4 4"]  # the first is the identity
    T_rig_board: Float[Array, "I 4 4"]  # at the middle row of the first view
    timing: Timing = GLOBAL
    lag: Float[Array, "V"] | None = None  # seconds; of the first view 0
    readout: Float[Array, "V"] | None = None  # seconds from the first row to the last
    T_board_own: Float[Array, "V 4 4"] | None = None  # boards of their own, fixed to the first one

    @property
    def lens_columns(self) -> Int[Array, "V+1"]:
        """First common column of each view's lens; then that of the camera poses."""
        return np.cumsum([0, *map(len, self.lenses)])

    @property
    def lag_column(self) -> int:
        """First common column of the lags."""
        return int(self.lens_columns[-1]) + 6 * (len(self.lenses) - 1)

    @property
    def readout_column(self) -> int:
        """First common column of the readout times."""
        return self.lag_column + (len(self.lenses) - 1 if self.lag is not None else 0)

    @property
    def own_column(self) -> int:
        """First common column of the boards that views have of their own."""
        return self.readout_column + (len(self.lenses) if self.readout is not None else 0)

    @property
    def common(self) -> int:
        """Number of common unknowns."""
        owned = 6 * (len(self.lenses) - 1) if self.T_board_own is not None else 0
        return self.own_column + owned

    def moved(self, common: Float[Array, "C"], each: Float[Array, "I 6"]) -> State:
        """The state after a step of the unknowns."""
        first = self.lens_columns
        lenses = tuple(p + common[a:b] for p, a, b in zip(self.lenses, first, first[1:],
                                                          strict=False))  # fmt: skip
        cameras = self.T_view_rig.copy()
        cameras[1:] = moved_pose(cameras[1:], common[first[-1] : self.lag_column].reshape(-1, 6))
        boards = moved_pose(self.T_rig_board, each)
        lags = np.r_[0.0, common[self.lag_column : self.readout_column]]
        lag = None if self.lag is None else self.lag + lags
        more = common[self.readout_column : self.own_column]
        readout = None if self.readout is None else self.readout + more
        own = None if self.T_board_own is None else self.T_board_own.copy()
        if own is not None:
            own[1:] = moved_pose(own[1:], common[self.own_column :].reshape(-1, 6))
        return replace(self, lenses=lenses, T_view_rig=cameras, T_rig_board=boards, lag=lag,
                       readout=readout, T_board_own=own)  # fmt: skip

    def boards(self, view: int, instants: Int[Array, "n"]) -> Float[Array, "n 4 4"]:
        """T_rig_board of the board that a view sees."""
        first = self.T_rig_board[instants]
        return first if self.T_board_own is None else first @ self.T_board_own[view]


class Seen(NamedTuple):
    """The corners of one view, moved to it."""

    view: int
    at: Int[Array, "n"]  # among all corners
    arm: Float[Array, "n 3"]  # from the board's origin, in the rig's frame
    points: Float[Array, "n 3"]  # in the camera's frame
    rows: Float[Array, "n"]  # place in the readout, -1/2 to 1/2


def by_view(state: State, corners: Corners, points: Float[Array, "K 3"]) -> Iterator[Seen]:
    """The corners of each view at the values of `state`."""
    for v in range(len(state.lenses)):
        at = np.flatnonzero(corners.view == v)
        if not len(at):
            continue
        instant = corners.instant[at]
        T, origin = state.boards(v, instant), state.T_rig_board[instant, :3, 3]
        arm = np.einsum("nij,nj->ni", T[:, :3, :3], points[corners.corner[at]])
        arm += T[:, :3, 3] - origin
        rows = _rows(state, v, corners.pixels[at, 1])
        if state.timing.velocity is not None:
            moved, _ = _motion(state, v, instant, rows)
            arm = Rotation.from_rotvec(moved[:, :3]).apply(arm)
            origin = origin + moved[:, 3:]
        T_view = state.T_view_rig[v]
        yield Seen(v, at, arm, (arm + origin) @ T_view[:3, :3].T + T_view[:3, 3], rows)


def residuals_of(
    state: State, corners: Corners, points: Float[Array, "K 3"]
) -> Float[Array, "N 2"]:
    """Observed minus projected pixels."""
    residuals = np.empty((len(corners), 2))
    for seen in by_view(state, corners, points):
        shape, lens = state.shapes[seen.view], state.lenses[seen.view]
        residuals[seen.at] = corners.pixels[seen.at] - shape.project(seen.points, lens)[0]
    return residuals


def jacobian(
    state: State, corners: Corners, points: Float[Array, "K 3"]
) -> tuple[Float[Array, "N 2 C"], Float[Array, "N 2 6"]]:
    """Derivatives of the projected pixels by the common unknowns and by those of the instant."""
    common = np.zeros((len(corners), 2, state.common))
    each = np.zeros((len(corners), 2, 6))
    for v, at, arm, seen, rows in by_view(state, corners, points):
        _, by_point, by_lens = state.shapes[v].project(seen, state.lenses[v])
        first = state.lens_columns[v]
        common[at, :, first : first + len(state.lenses[v])] = by_lens
        T_view = state.T_view_rig[v]
        each[at] = by_board = _by_pose(by_point @ T_view[:3, :3], arm)
        if state.timing.velocity is not None:
            moved, velocity = _motion(state, v, corners.instant[at], rows)
            by_time = np.einsum("nij,nj->ni", by_board, velocity)
            each[at, :, :3] = by_board[..., :3] @ Rotation.from_rotvec(moved[:, :3]).as_matrix()
            if state.readout is not None:
                common[at, :, state.readout_column + v] = by_time * rows[:, None]
            if state.lag is not None and v > 0:
                common[at, :, state.lag_column + v - 1] = by_time
        if v > 0:
            first = int(state.lens_columns[-1]) + 6 * (v - 1)
            common[at, :, first : first + 6] = _by_pose(by_point, seen - T_view[:3, 3])
            if state.T_board_own is not None:
                first = state.own_column + 6 * (v - 1)
                turned = points[corners.corner[at]] @ state.T_board_own[v, :3, :3].T
                R = T_view[:3, :3] @ state.T_rig_board[corners.instant[at], :3, :3]
                common[at, :, first : first + 6] = _by_pose(by_point @ R, turned)
    return common, each


def _rows(state: State, view: int, v: Float[Array, "n"]) -> Float[Array, "n"]:
    if not state.timing.heights:
        return np.zeros_like(v)
    return (v + 0.5) / state.timing.heights[view] - 0.5


def _motion(
    state: State, view: int, instant: Int[Array, "n"], rows: Float[Array, "n"]
) -> tuple[Float[Array, "n 6"], Float[Array, "n 6"]]:
    """The board's motion from the middle row of the first view to the exposure of each corner's
    row, and its velocity then."""
    lag = 0.0 if state.lag is None else state.lag[view]
    late = (lag + (0.0 if state.readout is None else state.readout[view]) * rows)[:, None]
    velocity, acceleration = state.timing.velocity, state.timing.acceleration
    assert velocity is not None and acceleration is not None
    v, a = velocity[instant], acceleration[instant]
    moved, rate = late * v + 0.5 * late**2 * a, v + late * a
    rate[:, :3] += 0.5 * np.cross(moved[:, :3], rate[:, :3])  # of the turn, not of its vector
    return moved, rate


def _by_pose(by_point: Float[Array, "N 2 3"], arm: Float[Array, "N 3"]) -> Float[Array, "N 2 6"]:
    """Derivative by a turn on the left about the pose's origin, and by a shift."""
    return np.concatenate([by_point @ -skew(arm), by_point], 2)
