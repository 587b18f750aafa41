"""Lags of cameras are recovered from boards that move, within their standard deviations."""

from types import SimpleNamespace

import numpy as np
import pytest

from egocap.calibration.adjustment import adjust
from egocap.calibration.lag import board_velocities, require_small, require_times, with_lag
from egocap.calibration.lens_shape import LensShape
from egocap.calibration.model_choice import with_shape
from egocap.calibration.start import start_view
from egocap.calibration.state import Corners, State, joined
from egocap.errors import InputError
from egocap.geometry import axis_angle, inverse, rigid, transform
from egocap_sim.boards.path import draw_path

LAG = 0.008
FRAME = 1 / 30
KANNALA = LensShape("kannala_brandt")


@pytest.fixture(scope="module")
def recorded(board, rig):
    """State of a stereo calibration without lags, corners of frames in threes, and their times."""
    path = draw_path(board, rig, 25, np.random.default_rng(3))
    middle = path.times[1:-1]
    times = np.ravel(middle[:, None] + FRAME * np.arange(-1, 2))
    T_left_head = inverse(rig.T_head_camera[0])
    T_right_left = inverse(rig.T_head_camera[1]) @ rig.T_head_camera[0]
    left, right = (T_left_head @ path.T_rig_board(times + lag) for lag in (0.0, LAG))
    rng = np.random.default_rng(4)
    corners = joined([seen(rig.cameras[0], 0, left, board, rng),
                      seen(rig.cameras[1], 1, T_right_left @ right, board, rng)])  # fmt: skip
    alone = [start_view(corners[corners.view == v], board.points, (1280, 1024))
             for v in (0, 1)]  # fmt: skip
    shaped = [with_shape(each.state, KANNALA, board.points) for each in alone]
    lenses = tuple(each.lenses[0] for each in shaped)
    return (
        State((KANNALA, KANNALA), lenses, np.array([np.eye(4), T_right_left]), left),
        corners,
        times,
    )


def seen(camera, view, boards, board, rng):
    parts = []
    for i, T in enumerate(boards):
        pixels, valid = camera.project(transform(T, board.points))
        at = np.flatnonzero(valid)
        if len(at) >= 6:
            noisy = pixels[at] + 0.1 * rng.standard_normal((len(at), 2))
            parts.append(Corners(np.full(len(at), i), np.full(len(at), view), at, noisy,
                                 np.tile(np.eye(2), (len(at), 1, 1))))  # fmt: skip
    return joined(parts)


def test_lag_and_stereo_pose_from_moving_boards(recorded, rig, board):
    state, corners, times = recorded
    without = adjust(state, corners, board.points)
    timed, used = with_lag(without.state, corners, times)
    found = adjust(timed, used, board.points)
    std = float(np.sqrt(found.covariance[found.state.lag_column, found.state.lag_column]))
    assert std < 1e-3
    assert abs(found.state.lag[1] - LAG) < 4.0 * std + 1e-4
    truth = state.T_view_rig[1]
    off, before = (np.linalg.norm(a.state.T_view_rig[1][:3, 3] - truth[:3, 3])
                   for a in (found, without))  # fmt: skip
    assert off < 1e-3 and off < before
    require_small(found.state, times)


def test_velocities_are_known_between_neighbours_alone():
    times = np.array([0.0, 0.03, 0.06, 1.0, 1.03])
    turns = [axis_angle(np.array([0.0, 0.0, 1.0]), 2.0 * t) for t in times]
    boards = np.array([rigid(R, [0.5 * t, 0.0, 1.0]) for R, t in zip(turns, times, strict=True)])
    velocity, known = board_velocities(boards, np.ones(5, bool), times)
    assert known.tolist() == [False, True, False, False, False]
    assert np.allclose(velocity[1], [0, 0, 2.0, 0.5, 0, 0])


def test_what_tells_no_lag_is_refused(recorded):
    state, corners, times = recorded
    with pytest.raises(InputError, match="three frames in a row"):
        with_lag(state, corners[corners.instant < 6], times)
    with pytest.raises(InputError, match="from videos"):
        require_times(SimpleNamespace(times=None, views=(0, 1)), False)
    with pytest.raises(InputError, match="not both"):
        require_times(SimpleNamespace(times=np.zeros(3), views=(0, 1)), True)
    with pytest.raises(InputError, match="more than a frame"):
        require_small(SimpleNamespace(lag=np.array([0.0, 0.2])), times)
