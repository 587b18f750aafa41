"""How much later one camera exposes than another, from boards that move during a video.

A board that the first view sees at T is seen `lag` seconds later by another, moved by the lag times
its velocity, which is taken from the frames before and after. Boards without both say nothing about
the lag, and other views' corners of them are left out.

Source: Furgale et al. 2013, "Unified temporal and spatial calibration for multi-sensor systems",
with central differences in place of splines.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.spatial.transform import Rotation

from egocap.calibration.recording import Recording
from egocap.calibration.state import Corners, State
from egocap.errors import InputError

LEAST_MOVING = 5  # boards with a velocity, of each view but the first
_NEAR_S = 0.15  # between a frame and its neighbours


def with_lag(state: State, corners: Corners, times: Float[Array, "I"]) -> tuple[State, Corners]:
    """The state with lags as unknowns, and the corners that tell them.

    `times` of the instants in seconds. Raises InputError where too few boards are followed.
    """
    seen = np.isin(np.arange(len(times)), corners.instant)
    velocity, known = board_velocities(state.T_rig_board, seen, times)
    used = corners[(corners.view == 0) | known[corners.instant]]
    for v in range(1, len(state.lenses)):
        boards = len(np.unique(used.instant[used.view == v]))
        if boards < LEAST_MOVING:
            raise InputError(
                f"only {boards} boards are seen in three frames in a row by camera {v + 1}",
                valid=f"{LEAST_MOVING} or more, from videos of the same frame rate in which the "
                "board moves slowly, without blur, before both cameras",
            )
    lags = np.zeros(len(state.lenses))
    return replace(state, timing=replace(state.timing, velocity=velocity), lag=lags), used


def board_velocities(
    T_rig_board: Float[Array, "I 4 4"], seen: Bool[Array, "I"], times: Float[Array, "I"]
) -> tuple[Float[Array, "I 6"], Bool[Array, "I"]]:
    """Turn [rad/s] and shift [m/s] of each board, by central differences, and where known."""
    velocity, known = np.zeros((len(times), 6)), np.zeros(len(times), bool)
    for i in range(1, len(times) - 1):
        before, after = times[i] - times[i - 1], times[i + 1] - times[i]
        if max(before, after) > _NEAR_S or not seen[i - 1 : i + 2].all():
            continue
        a, b = T_rig_board[i - 1], T_rig_board[i + 1]
        turn = Rotation.from_matrix(b[:3, :3] @ a[:3, :3].T).as_rotvec()
        velocity[i] = np.r_[turn, b[:3, 3] - a[:3, 3]] / (before + after)
        known[i] = True
    return velocity, known


def require_times(recording: Recording, fixed_boards: bool) -> Float[Array, "I"]:
    """Times of the instants. Raises InputError for pictures, one camera, and fixed boards."""
    if fixed_boards:
        raise InputError("a lag is found from a board that all cameras see",
                         valid="--lag or --fixed-boards, not both")  # fmt: skip
    if recording.times is None or len(recording.views) < 2:
        raise InputError("a lag is found from videos of two or more cameras",
                         valid="a video per camera, or no --lag")  # fmt: skip
    return recording.times


def require_small(state: State, times: Float[Array, "I"]) -> None:
    """Raise InputError for a lag beyond the frames that velocities come from."""
    if state.lag is None:
        return
    frame = float(np.diff(times).min())
    worst = state.lag[np.abs(state.lag).argmax()]
    if abs(worst) > frame:
        raise InputError(
            f"a camera lags by {1000 * worst:.0f} ms, more than a frame ({1000 * frame:.0f} ms)",
            valid="videos cut so that they start within a frame of each other",
        )
