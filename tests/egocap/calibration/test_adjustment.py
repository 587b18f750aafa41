"""The adjustment on ideal corners with known noise, and against OpenCV on the same corners."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from egocap.calibration.adjustment import adjust
from egocap.calibration.lens_shape import LensShape, lens_shapes
from egocap.calibration.model_choice import choose_shape, with_shape
from egocap.calibration.planar_pose import planar_pose
from egocap.calibration.start import start_view
from egocap.calibration.state import GLOBAL, Corners, State, Timing, jacobian, joined, residuals_of
from egocap.geometry import inverse, transform, unit

KANNALA = LensShape("kannala_brandt")
SIZE = (1280, 1024)


@pytest.fixture(scope="module")
def started(corners, board):
    return start_view(corners[corners.view == 0], board.points, SIZE)


@pytest.fixture(scope="module")
def fitted(started, corners, board):
    state = with_shape(started.state, KANNALA, board.points)
    return adjust(state, corners[corners.view == 0], board.points)


def test_planar_pose_beyond_90_degrees_off_axis(board, boards):
    for T in boards:
        rays = unit(transform(T, board.points))
        found, error = planar_pose(rays, board.points)
        assert error < 1e-6
        assert np.allclose(found, T, atol=1e-5)


def test_start_needs_no_guess(started):
    assert np.abs(started.state.lenses[0][:2] - [642, 509]).max() < 5
    assert started.state.lenses[0][2] == pytest.approx(402, rel=0.03)


def test_residuals_are_the_noise(fitted):
    assert fitted.converged
    assert fitted.scale == pytest.approx(0.1, rel=0.06)


def test_parameters_lie_within_their_stated_deviations(fitted, rig):
    camera = rig.cameras[0]
    truth = np.array([*camera.centre, camera.affine[0][0], camera.affine[1][1], *camera.parameters])
    error = fitted.state.lenses[0] - truth
    normalised = error @ np.linalg.solve(fitted.covariance[:8, :8], error) / 8
    assert 0.1 < normalised < 2.6  # chi^2 of 8: 0.1 and 99.9 percentiles


def test_no_worse_than_opencv_on_the_same_corners(fitted, corners, board):
    """cv2.fisheye has the same model; it refuses rays beyond 90 degrees and needs a guess."""
    own = corners[corners.view == 0]
    objects, images = [], []
    for i in np.unique(own.instant):
        at = own.instant == i
        seen = transform(fitted.state.T_rig_board[i], board.points[own.corner[at]])
        if np.arctan2(np.hypot(*seen.T[:2]), seen[:, 2]).max() < np.deg2rad(70):
            objects.append(board.points[own.corner[at]][None])
            images.append(own.pixels[at][None])
    K, D = np.array([[400.0, 0, 640], [0, 400, 512], [0, 0, 1]]), np.zeros((4, 1))
    flags = cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW | cv2.CALIB_USE_INTRINSIC_GUESS
    theirs, K, _, _, _ = cv2.fisheye.calibrate(objects, images, SIZE, K, D, flags=flags)
    parts = [Corners(np.full(len(o[0]), n), np.zeros(len(o[0]), int),
                     np.array([np.abs(board.points - x).sum(1).argmin() for x in o[0]]), p[0],
                     np.tile(np.eye(2), (len(o[0]), 1, 1)))
             for n, (o, p) in enumerate(zip(objects, images, strict=True))]  # fmt: skip
    same = Corners(*(np.concatenate([getattr(c, k) for c in parts])
                     for k in ("instant", "view", "corner", "pixels", "whitening")))  # fmt: skip
    state = with_shape(start_view(same, board.points, SIZE).state, KANNALA, board.points)
    ours = adjust(state, same, board.points)
    assert np.sqrt(2) * ours.rms < 1.01 * theirs  # theirs counts points, ours coordinates
    assert ours.state.lenses[0][2] == pytest.approx(K[0, 0], rel=2e-3)


def test_held_out_error_rejects_a_lens_that_does_not_fit(started, corners, board):
    own = corners[corners.view == 0]
    choice = choose_shape(started, own, board.points, lens_shapes(None, SIZE))
    assert choice.shape.model != "equidistant"
    assert choice.held_out["equidistant"] > 1.2 * min(choice.held_out.values())


def stereo_state(fitted, rig, boards):
    T = inverse(rig.T_head_camera[1]) @ rig.T_head_camera[0]
    lens = np.array([*rig.cameras[1].centre, 410.0, 410.0, 0.0, 0.0, 0.0, 0.0])
    return State(
        (KANNALA, KANNALA), (fitted.state.lenses[0], lens), np.array([np.eye(4), T]), boards
    )


def test_derivatives_of_all_unknowns_are_those_of_differences(fitted, rig, boards, board, corners):
    rng = np.random.default_rng(0)
    state = stereo_state(fitted, rig, boards)
    timing = Timing((1024, 1024), *0.1 * rng.standard_normal((2, len(boards), 6)))
    timed = State(state.shapes, state.lenses, state.T_view_rig, boards, timing,
                  np.array([0.0, 0.1]), np.array([0.1, -0.1]))  # fmt: skip
    common, each = jacobian(timed, corners, board.points)

    def difference(c, e):
        ahead = residuals_of(timed.moved(c, e), corners, board.points)
        behind = residuals_of(timed.moved(-c, -e), corners, board.points)
        return (behind - ahead) / 2e-6

    for k in range(timed.common):
        found = difference(1e-6 * np.eye(timed.common)[k], np.zeros((len(boards), 6)))
        assert np.allclose(common[:, :, k], found, rtol=1e-4, atol=2e-3), k
    for k in range(6):
        step = np.zeros((len(boards), 6))
        step[:, k] = 1e-6
        assert np.allclose(each[:, :, k], difference(np.zeros(timed.common), step), rtol=1e-4,
                           atol=2e-3), k  # fmt: skip


def test_stereo_pose(fitted, rig, boards, board, corners):
    found = adjust(stereo_state(fitted, rig, boards), corners, board.points)
    truth = inverse(rig.T_head_camera[1]) @ rig.T_head_camera[0]
    assert found.state.timing is GLOBAL
    assert np.linalg.norm(found.state.T_view_rig[1][:3, 3] - truth[:3, 3]) < 5e-4


def test_outliers_do_not_move_the_lens(fitted, corners, board):
    own = corners[corners.view == 0]
    pixels = own.pixels.copy()
    pixels[::25] += 8.0
    wrong = Corners(own.instant, own.view, own.corner, pixels, own.whitening)
    found = adjust(fitted.state, wrong, board.points)
    assert np.abs(found.state.lenses[0][:4] - fitted.state.lenses[0][:4]).max() < 0.6


@pytest.fixture(scope="module")
def before_own_boards(fitted, rig, boards, board):
    """Two cameras that turn back to back, each before a fixed board, and their noisy corners."""
    rng, parts = np.random.default_rng(9), []
    truth = inverse(rig.T_head_camera[1]) @ rig.T_head_camera[0]
    own = inverse(boards[0]) @ inverse(truth) @ boards[5]
    state = replace(stereo_state(fitted, rig, boards), T_board_own=np.array([np.eye(4), own]))
    for v, mount in enumerate(rig.mounts):
        T = state.T_view_rig[v] if v == 0 else truth
        for i in range(len(boards)):
            points = transform(T @ state.boards(v, np.array([i]))[0], board.points)
            pixels, valid = mount.camera.project(points)
            at = np.flatnonzero(valid)
            if len(at) >= 6:
                seen = pixels[at] + 0.1 * rng.standard_normal((len(at), 2))
                parts.append(Corners(np.full(len(at), i), np.full(len(at), v), at, seen,
                                     np.tile(np.eye(2), (len(at), 1, 1))))  # fmt: skip
    return state, joined(parts), truth, own


def test_derivatives_by_the_boards_of_their_own(before_own_boards, board):
    state, corners, _, _ = before_own_boards
    common, each = jacobian(state, corners, board.points)
    assert state.common == state.own_column + 6 == common.shape[2]
    still = np.zeros((len(state.T_rig_board), 6))
    for k in range(state.lag_column - 6, state.common):
        step = 1e-6 * np.eye(state.common)[k]
        ahead, behind = (residuals_of(state.moved(s * step, still), corners, board.points)
                         for s in (1, -1))  # fmt: skip
        assert np.allclose(common[:, :, k], (behind - ahead) / 2e-6, rtol=1e-4, atol=2e-3), k
    for k in range(6):
        step = np.zeros_like(still)
        step[:, k] = 1e-6
        nothing = np.zeros(state.common)
        ahead, behind = (residuals_of(state.moved(nothing, s * step), corners, board.points)
                         for s in (1, -1))  # fmt: skip
        assert np.allclose(each[:, :, k], (behind - ahead) / 2e-6, rtol=1e-4, atol=2e-3), k


def test_stereo_pose_from_boards_of_their_own(before_own_boards, board):
    """Within four of the stated standard deviations, which are below a millimetre."""
    state, corners, truth, own = before_own_boards
    found = adjust(state, corners, board.points)
    first = int(found.state.lens_columns[-1])
    std = np.sqrt(np.diag(found.covariance))[first:]
    assert found.converged and std[3:6].max() < 1e-3
    for T, true, spread in ((found.state.T_view_rig[1], truth, std[:6]),
                            (found.state.T_board_own[1], own, std[6:])):  # fmt: skip
        turn = Rotation.from_matrix(T[:3, :3] @ true[:3, :3].T).as_rotvec()
        assert (np.abs(np.r_[turn, T[:3, 3] - true[:3, 3]]) < 4.0 * spread).all()
