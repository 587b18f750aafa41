"""How much later one camera exposes than another, and how long a camera reads a picture out.

Both come from boards that move during a video. A board that the middle row of the first view sees
at T is seen `lag` seconds later by another view, and by the first and last row of a rolling shutter
half its readout earlier and later, moved by its velocity and acceleration, which are taken from
three frames in a row. Boards that are not in such say nothing, and their corners are left out.

Source: Furgale et al. 2013, "Unified temporal and spatial calibration for multi-sensor systems",
and Oth et al. 2013, "Rolling shutter camera calibration", with central differences in place of
splines.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.spatial.transform import Rotation

from egocap.calibration.recording import Recording
from egocap.calibration.state import Corners, State, Timing
from egocap.errors import InputError

LEAST_MOVING = 5  # boards with a velocity, of each view that they tell of
_NEAR_S = 0.15  # between a frame and its neighbours


@dataclass(frozen=True, eq=False)
class Clock:
    """What to find about time: lags, readout times, or both."""

    lag: bool
    readout: bool
    times: Float[Array, "I"]  # of the instants, seconds
    heights: tuple[int, ...]  # of the views' pictures, pixels


def clock_of(recording: Recording, *, lag: bool, readout: bool, fixed_boards: bool) -> Clock | None:
    """What is to be found, None: nothing.

    Raises InputError for pictures, a lag of one camera, and fixed boards.
    """
    if not lag and not readout:
        return None
    option, what = ("--lag", "a lag") if lag else ("--readout", "a readout time")
    if fixed_boards:
        raise InputError(f"{what} is found from a board that is moved before the cameras",
                         valid=f"{option} or --fixed-boards, not both")  # fmt: skip
    if recording.times is None or (lag and len(recording.views) < 2):
        more = " of two or more cameras" if lag else ""
        raise InputError(f"{what} is found from videos{more}",
                         valid=f"a video per camera, or no {option}")  # fmt: skip
    return Clock(lag, readout, recording.times, tuple(v.size[1] for v in recording.views))


def with_timing(state: State, corners: Corners, clock: Clock) -> tuple[State, Corners]:
    """The state with lags and readout times as unknowns, and the corners that tell them.

    Values already in the state start the search. Raises InputError where too few boards are
    followed.
    """
    seen = np.isin(np.arange(len(clock.times)), corners.instant)
    velocity, acceleration, followed = board_motions(state.T_rig_board, seen, clock.times)
    known = np.abs(acceleration).max(1) > 0.0
    views = len(state.lenses)
    told = np.arange(views) > 0 if not clock.readout else np.ones(views, bool)
    used = corners[~told[corners.view] | known[corners.instant]]
    for v in np.flatnonzero(told):
        boards = int(followed[np.unique(used.instant[used.view == v])].sum())
        if boards < LEAST_MOVING:
            raise InputError(
                f"only {boards} boards are seen in three frames in a row by camera {v + 1}",
                valid=f"{LEAST_MOVING} or more, from videos of the same frame rate in which the "
                "board moves slowly, without blur, before all cameras",
            )
    none = np.zeros(views)
    lag = (none if state.lag is None else state.lag) if clock.lag else None
    readout = (none if state.readout is None else state.readout) if clock.readout else None
    timing = Timing(clock.heights, velocity, acceleration)
    return replace(state, timing=timing, lag=lag, readout=readout), used


def board_motions(
    T_rig_board: Float[Array, "I 4 4"], seen: Bool[Array, "I"], times: Float[Array, "I"]
) -> tuple[Float[Array, "I 6"], Float[Array, "I 6"], Bool[Array, "I"]]:
    """Velocity and acceleration of each board (turn [rad/s], shift [m/s]; a second), by differences
    to the frames before and after, and which have both. Those frames get the same acceleration."""
    velocity, acceleration = np.zeros((2, len(times), 6))
    followed = np.zeros(len(times), bool)
    for i in range(1, len(times) - 1):
        before, after = times[i] - times[i - 1], times[i + 1] - times[i]
        if max(before, after) > _NEAR_S or not seen[i - 1 : i + 2].all():
            continue
        first, second = (_step(T_rig_board[i + k], T_rig_board[i + k + 1]) / seconds
                         for k, seconds in ((-1, before), (0, after)))  # fmt: skip
        here = (first * after + second * before) / (before + after)
        change = 2.0 * (second - first) / (before + after)
        for k, seconds in ((i - 1, -before), (i, 0.0), (i + 1, after)):
            if k == i or not followed[k]:
                velocity[k], acceleration[k] = here + seconds * change, change
        followed[i] = True
    return velocity, acceleration, followed


def _step(a: Float[Array, "4 4"], b: Float[Array, "4 4"]) -> Float[Array, "6"]:
    turn = Rotation.from_matrix(b[:3, :3] @ a[:3, :3].T).as_rotvec()
    return np.r_[turn, b[:3, 3] - a[:3, 3]]


def require_small(state: State, times: Float[Array, "I"]) -> None:
    """Raise InputError for times beyond the frames that velocities come from."""
    frame = float(np.diff(times).min())
    for values, what in ((state.lag, "lags by"), (state.readout, "reads its pictures out in")):
        if values is None:
            continue
        worst = values[np.abs(values).argmax()]
        if abs(worst) > frame:
            raise InputError(
                f"a camera {what} {1000 * worst:.0f} ms, more than a frame ({1000 * frame:.0f} ms)",
                valid="videos cut so that they start within a frame of each other, of a board "
                "that moves slowly",
            )
