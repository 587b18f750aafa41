"""Lags and readout times are recovered from boards that move, within their standard deviations."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from egocap.calibration.adjustment import adjust
from egocap.calibration.lens_shape import LensShape
from egocap.calibration.model_choice import with_shape
from egocap.calibration.start import start_view
from egocap.calibration.state import Corners, State, joined
from egocap.calibration.timing import Clock, board_motions, clock_of, require_small, with_timing
from egocap.errors import InputError
from egocap.geometry import axis_angle, inverse, rigid
from egocap_sim.boards.path import draw_path

LAG, READOUT = 0.008, (0.021, 0.013)
FRAME = 1 / 30
BETWEEN = 0.3  # seconds after a rest of the hand, on its way to the next
SIZE = (1280, 1024)
KANNALA = LensShape("kannala_brandt")


@pytest.fixture(scope="module")
def film(board, rig):
    """Poses of the board over time in each camera, and times of frames in threes."""
    path = draw_path(board, rig, 25, np.random.default_rng(3))
    middle = path.times[1:-1]
    times = np.ravel(middle[:, None] + FRAME * np.arange(-1, 2)) + BETWEEN
    views = inverse(rig.T_head_camera)
    return [lambda t, T=T: T @ path.T_rig_board(t) for T in views], times


@pytest.fixture(scope="module")
def recorded(film, board, rig):
    """State of a stereo calibration without lags, corners of frames in threes, and their times."""
    return calibrated(film, board, rig, (0.0, 0.0))


@pytest.fixture(scope="module")
def rolling(film, board, rig):
    """The same with rolling shutters."""
    return calibrated(film, board, rig, READOUT)


def calibrated(film, board, rig, readouts):
    poses, times = film
    rng = np.random.default_rng(4)
    corners = joined([
        seen(rig.cameras[v], v, poses[v], times + lag, readouts[v], board, rng)
        for v, lag in enumerate((0.0, LAG))
    ])  # fmt: skip
    apart = [corners[corners.view == v] for v in (0, 1)]
    alone = [start_view(replace(own, view=0 * own.view), board.points, SIZE) for own in apart]
    shaped = [with_shape(each.state, KANNALA, board.points) for each in alone]
    lenses = tuple(each.lenses[0] for each in shaped)
    T_right_left = inverse(rig.T_head_camera[1]) @ rig.T_head_camera[0]
    state = State((KANNALA, KANNALA), lenses, np.array([np.eye(4), T_right_left]), poses[0](times))
    return state, corners, times


def seen(camera, view, pose, times, readout, board, rng):
    """Noisy corners, each where it is when its row is read."""
    parts = []
    for i, time in enumerate(times):
        late = np.zeros(len(board.points))
        for _ in range(6):
            T = pose(time + late)
            points = np.einsum("nij,nj->ni", T[:, :3, :3], board.points) + T[:, :3, 3]
            pixels, valid = camera.project(points)
            late = readout * (
                (np.clip(np.nan_to_num(pixels[:, 1]), 0, SIZE[1]) + 0.5) / SIZE[1] - 0.5
            )
        at = np.flatnonzero(valid)
        if len(at) >= 6:
            noisy = pixels[at] + 0.1 * rng.standard_normal((len(at), 2))
            parts.append(Corners(np.full(len(at), i), np.full(len(at), view), at, noisy,
                                 np.tile(np.eye(2), (len(at), 1, 1))))  # fmt: skip
    return joined(parts)


def adjusted(recorded, board, **wanted):
    """The adjustment without times, and with those that are wanted."""
    state, corners, times = recorded
    clock = Clock(wanted.get("lag", False), wanted.get("readout", False), times, (SIZE[1],) * 2)
    found = without = adjust(state, corners, board.points)
    for _ in range(3):
        timed, used = with_timing(found.state, corners, clock)
        found = adjust(timed, used, board.points)
    require_small(found.state, times)
    return without, found


def test_lag_and_stereo_pose_from_moving_boards(recorded, board):
    without, found = adjusted(recorded, board, lag=True)
    std = float(np.sqrt(found.covariance[found.state.lag_column, found.state.lag_column]))
    assert std < 1e-3
    assert abs(found.state.lag[1] - LAG) < 4.0 * std + 1e-4
    truth = recorded[0].T_view_rig[1]
    off, before = (np.linalg.norm(a.state.T_view_rig[1][:3, 3] - truth[:3, 3])
                   for a in (found, without))  # fmt: skip
    assert off < 1e-3 and off < before


def test_readout_of_rolling_shutters(rolling, board):
    """Within four standard deviations, which are below a millisecond; with the lag beside."""
    without, found = adjusted(rolling, board, lag=True, readout=True)
    state, std = found.state, np.sqrt(np.diag(found.covariance))
    own = std[state.readout_column : state.own_column]
    assert own.max() < 1e-3 and std[state.lag_column] < 1e-3
    assert (np.abs(state.readout - READOUT) < 4.0 * own + 1e-4).all()
    assert abs(state.lag[1] - LAG) < 4.0 * std[state.lag_column] + 1e-4
    assert found.rms < 0.11 < without.rms


def test_a_global_shutter_has_no_readout(recorded, board):
    _, found = adjusted(recorded, board, lag=True, readout=True)
    own = np.sqrt(np.diag(found.covariance))[found.state.readout_column : found.state.own_column]
    assert (np.abs(found.state.readout) < 4.0 * own + 1e-4).all()


def test_motions_are_known_where_three_frames_are_near():
    """Constant velocity, with acceleration along z, at uneven times."""
    times = np.array([0.0, 0.03, 0.07, 1.0, 1.03])
    turns = [axis_angle(np.array([0.0, 0.0, 1.0]), 2.0 * t) for t in times]
    boards = np.array([rigid(R, [0.5 * t, 0.0, 1.0 + 3.0 * t**2])
                       for R, t in zip(turns, times, strict=True)])  # fmt: skip
    velocity, acceleration, followed = board_motions(boards, np.ones(5, bool), times)
    assert followed.tolist() == [False, True, False, False, False]
    assert np.allclose(velocity[:3, :5], [0, 0, 2.0, 0.5, 0])
    assert np.allclose(velocity[:3, 5], 6.0 * times[:3])
    assert np.allclose(acceleration[:3], [0, 0, 0, 0, 0, 6.0])
    assert not acceleration[3:].any()


def test_what_tells_no_times_is_refused(recorded):
    state, corners, times = recorded
    with pytest.raises(InputError, match="three frames in a row"):
        with_timing(state, corners[corners.instant < 6], Clock(True, False, times, (1024, 1024)))
    view = SimpleNamespace(size=SIZE)
    pictures = SimpleNamespace(times=None, views=(view, view))
    alone = SimpleNamespace(times=times, views=(view,))
    with pytest.raises(InputError, match="a lag is found from videos of two"):
        clock_of(alone, lag=True, readout=False, fixed_boards=False)
    with pytest.raises(InputError, match="a readout time is found from videos"):
        clock_of(pictures, lag=False, readout=True, fixed_boards=False)
    with pytest.raises(InputError, match="--readout or --fixed-boards, not both"):
        clock_of(alone, lag=False, readout=True, fixed_boards=True)
    assert clock_of(alone, lag=False, readout=True, fixed_boards=False).heights == (1024,)
    assert clock_of(pictures, lag=False, readout=False, fixed_boards=True) is None
    for name, said in (("lag", "lags by 200 ms"), ("readout", "reads its pictures out in 200 ms")):
        state = SimpleNamespace(**{"lag": None, "readout": None, name: np.array([0.0, 0.2])})
        with pytest.raises(InputError, match=said):
            require_small(state, times)
