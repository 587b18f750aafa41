"""Camera poses before fixed boards, lags and readout times from synthetic corners: no pictures.

Corners are the cameras' own projections with Gaussian noise as large as that of corners measured in
rendered pictures, so that what is left out is the detection of boards. The adjustment starts from
the truth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.spatial.transform import Rotation

from egocap.boards.board import Board
from egocap.calibration.adjustment import Adjusted, adjust
from egocap.calibration.lens_shape import LensShape
from egocap.calibration.state import Corners, State, joined
from egocap.calibration.timing import Clock, with_timing
from egocap.cameras.rig import Rig
from egocap.geometry import inverse, rigid
from egocap_sim.boards.path import draw_path

NOISE_PX = 0.04
"""Standard deviation of a coordinate of a corner measured in rendered pictures."""
TIMED_ROUNDS = 3  # as `egocap.calibration.rig_calibration` has them
LAG_S, READOUT_S = 0.008, (0.021, 0.013)
BETWEEN_S, FRAME_S = 0.3, 1.0 / 30.0
KANNALA = LensShape("kannala_brandt")
_WIDEST = np.deg2rad(85.0)
_LEAST = 8  # corners of a picture


class Fixed(NamedTuple):
    """A recording before fixed boards."""

    pictures: int
    turn_deg: float  # largest turn of the rig about every axis
    away_m: float  # from each camera to its board

    def __str__(self) -> str:
        return f"{self.pictures} pictures, {self.turn_deg} degrees, {self.away_m} m"


Pose = Callable[[Float[Array, "n"]], Float[Array, "n 4 4"]]
"""T_view_board at times in seconds."""


def fixed_boards(rig: Rig, board: Board, case: Fixed, rng: np.random.Generator) -> dict[str, float]:
    """A rig that turns, each camera before its own board.

    Errors of the second camera's pose [mm, degrees], their standard deviations (all axes together),
    those with known lenses, and the normalised error.
    """
    T_rig_view = inverse(rig.T_head_camera[0]) @ rig.T_head_camera
    middle = rigid(np.eye(3), -np.array([*board.size, 0.0]) / 2)
    places = T_rig_view @ rigid(np.eye(3), np.array([0.0, 0.0, case.away_m])) @ middle
    count = case.pictures
    turns = np.deg2rad(case.turn_deg) * rng.uniform(-1.0, 1.0, (count, 3))
    moves = rigid(
        Rotation.from_rotvec(turns).as_matrix(), 0.05 * rng.uniform(-1.0, 1.0, (count, 3))
    )
    seen = [inverse(T_rig_view[v]) @ moves @ places[v] for v in range(2)]
    own = np.array([np.eye(4), inverse(places[0]) @ places[1]])
    corners = joined([_corners(rig, v, lambda i, T=T: T[i.astype(int)], np.arange(count), 0.0,
                               board, rng) for v, T in enumerate(seen)])  # fmt: skip
    state = replace(_state(rig, seen[0]), T_board_own=own)
    return _pose_scores(adjust(state, corners, board.points), inverse(T_rig_view[1]))


def timed(rig: Rig, board: Board, count: int, rng: np.random.Generator) -> dict[str, Any]:
    """A board that a hand moves, filmed in threes with a lag and rolling shutters.

    Errors and standard deviations of the lag and of the readout times, milliseconds.
    """
    path = draw_path(board, rig, count, rng)
    times = np.ravel(path.times[1:-1, None] + FRAME_S * np.arange(-1, 2)) + BETWEEN_S
    poses = [lambda t, T=T: T @ path.T_rig_board(t) for T in inverse(rig.T_head_camera)]
    lags = (0.0, LAG_S)
    corners = joined([_corners(rig, v, poses[v], times + lags[v], READOUT_S[v], board, rng)
                      for v in range(2)])  # fmt: skip
    clock = Clock(True, True, times, tuple(camera.height for camera in rig.cameras))
    found = adjust(_state(rig, poses[0](times)), corners, board.points)
    for _ in range(TIMED_ROUNDS):
        state, used = with_timing(found.state, corners, clock)
        found = adjust(state, used, board.points)
    state, std = found.state, np.sqrt(np.diag(found.covariance))
    own = std[state.lag_column : state.own_column]
    assert state.lag is not None and state.readout is not None
    off = np.append(state.lag[1:] - LAG_S, state.readout - READOUT_S)
    names = ("lag", "readout_left", "readout_right")
    return {name: {"error_ms": float(1e3 * e), "std_ms": float(1e3 * s)}
            for name, e, s in zip(names, off, own, strict=True)}  # fmt: skip


def _state(rig: Rig, T_first_board: Float[Array, "I 4 4"]) -> State:
    """The truth of equidistant lenses as Kannala-Brandt lenses."""
    lenses = tuple(np.array([*c.centre, c.affine[0][0], c.affine[1][1], 0.0, 0.0, 0.0, 0.0])
                   for c in rig.cameras)  # fmt: skip
    T_view_rig = inverse(rig.T_head_camera) @ rig.T_head_camera[0]
    return State((KANNALA,) * len(lenses), lenses, T_view_rig, T_first_board)


def _corners(
    rig: Rig, view: int, pose: Pose, times: Sequence[float] | Array, readout: float, board: Board,
    rng: np.random.Generator,
) -> Corners:  # fmt: skip
    """Noisy corners, each where it is when its row is read."""
    camera, parts = rig.cameras[view], []
    for i, time in enumerate(times):
        late = np.zeros(len(board.points))
        for _ in range(5 if readout else 1):
            T = pose(time + late)
            points = np.einsum("nij,nj->ni", T[:, :3, :3], board.points) + T[:, :3, 3]
            pixels, valid = camera.project(points)
            rows = np.clip(np.nan_to_num(pixels[:, 1]), 0, camera.height)
            late = readout * ((rows + 0.5) / camera.height - 0.5)
        angle = np.arctan2(np.hypot(points[:, 0], points[:, 1]), points[:, 2])
        front = (points * T[:, :3, 2]).sum(1) > 0
        at = np.flatnonzero(valid & front & (angle < _WIDEST))
        if len(at) >= _LEAST:
            noisy = pixels[at] + NOISE_PX * rng.standard_normal((len(at), 2))
            parts.append(Corners(np.full(len(at), i), np.full(len(at), view), at, noisy,
                                 np.tile(np.eye(2), (len(at), 1, 1))))  # fmt: skip
    return joined(parts)


def _pose_scores(found: Adjusted, T_view_rig: Float[Array, "4 4"]) -> dict[str, float]:
    first = int(found.state.lens_columns[-1])
    own = slice(first, first + 6)
    covariance = found.covariance[own, own]
    given_lens = np.linalg.inv(np.linalg.inv(found.covariance)[first:, first:])[:6, :6]
    T = found.state.T_view_rig[1]
    turn = Rotation.from_matrix(T[:3, :3] @ T_view_rig[:3, :3].T).as_rotvec()
    step = np.append(turn, T[:3, 3] - T_view_rig[:3, 3])

    def size(squares: Array) -> tuple[float, float]:
        turned, moved = np.sqrt(squares[:3].sum()), np.sqrt(squares[3:].sum())
        return float(np.degrees(turned)), float(1e3 * moved)

    names = ("degrees", "millimetres")
    scores = dict(zip(names, size(step**2), strict=True))
    for name, each in (("std", covariance), ("std_known_lens", given_lens)):
        values = size(np.diag(each))
        scores |= {f"{unit}_{name}": x for unit, x in zip(names, values, strict=True)}
    normalised = np.sqrt(step @ np.linalg.solve(covariance, step) / 6)
    return scores | {"normalised": float(normalised)}
