"""Camera poses from boards seen by both, in spite of wrong ones; too few of them."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from egocap.boards.board import parse_board
from egocap.calibration.adjustment import Adjusted
from egocap.calibration.lens_shape import LensShape
from egocap.calibration.model_choice import Choice
from egocap.calibration.recording import View
from egocap.calibration.state import Corners, State
from egocap.calibration.stereo import fixed_boards, half_turn, same_way_round, start_poses
from egocap.calibration.view_calibration import ViewCalibration
from egocap.errors import InputError
from egocap.geometry import axis_angle, rigid, transform, unit
from tests.egocap.conftest import peak_below

T_RIGHT_LEFT = rigid(axis_angle(np.array([0.0, 1.0, 0.0]), 0.3), [-0.3, 0.02, 0.01])


def views(board, boards, shared):
    """Two views of boards, the second with half turns where the board allows them."""
    turned = half_turn(board) if board.symmetric else np.eye(4)
    right = {i: T_RIGHT_LEFT @ boards[i] @ (turned if i % 2 else np.eye(4)) for i in shared}
    return [SimpleNamespace(poses=dict(enumerate(boards)), view=SimpleNamespace(name="left")),
            SimpleNamespace(poses=right, view=SimpleNamespace(name="right"))]  # fmt: skip


@pytest.mark.parametrize("text", ["checkerboard:5x7:0.03", "checkerboard:6x7:0.03"])
def test_most_boards_agree(boards, text):
    pair = views(parse_board(text), boards, range(9))
    pair[1].poses[0] = boards[3]  # wrong
    found = start_poses(pair, parse_board(text))
    assert np.allclose(found[1], T_RIGHT_LEFT, atol=1e-9)


def test_too_few_shared_boards(boards):
    board = parse_board("checkerboard:6x7:0.03")
    with pytest.raises(InputError, match="right: only 2 boards are seen together"):
        start_poses(views(board, boards, range(2)), board)


def test_pictures_mostly_of_other_instants(boards):
    board = parse_board("charuco:5x7:0.03:0.02")
    pair = views(board, boards, range(12))
    wrong = {i: T_RIGHT_LEFT @ boards[i + 12] for i in range(7)}
    pair[1].poses = pair[1].poses | wrong
    with pytest.raises(InputError, match=r"right: only 5 of 12 pictures .*the same instants"):
        start_poses(pair, board)
    pair[1].poses[6] = T_RIGHT_LEFT @ boards[6]
    assert np.allclose(start_poses(pair, board)[1], T_RIGHT_LEFT, atol=1e-9)


def test_a_camera_is_placed_by_one_that_it_agrees_with(boards):
    """Most boards of the left and the third camera are wrong, none of the right and the third."""
    board = parse_board("charuco:5x7:0.03:0.02")
    pair = views(board, boards, range(4))
    third = {i: T_RIGHT_LEFT @ pair[1].poses[i] for i in range(4)}
    wrong = {i: third[0] @ boards[i] @ boards[i - 1] for i in range(4, 12)}
    low = SimpleNamespace(poses=third | wrong, view=SimpleNamespace(name="low"))
    found = start_poses([*pair, low], board)
    assert np.allclose(found[2], T_RIGHT_LEFT @ T_RIGHT_LEFT, atol=1e-9)


def test_half_turn_maps_a_symmetric_board_onto_itself():
    board = parse_board("checkerboard:5x7:0.03")
    turned = transform(half_turn(board), board.points)
    assert np.allclose(turned, board.points[::-1])


def test_boards_are_numbered_alike_in_all_views(boards):
    board = parse_board("checkerboard:5x7:0.03")
    cameras = np.array([np.eye(4), T_RIGHT_LEFT])
    found = [calibrated(board, boards[:5], np.eye(4), set()),
             calibrated(board, boards[:5], T_RIGHT_LEFT, {1, 3})]  # fmt: skip
    same = same_way_round(found, cameras, board)
    assert not np.array_equal(found[1].corners.corner, found[0].corners.corner)
    assert np.array_equal(same[1].corners.corner, same[0].corners.corner)
    for i in range(5):
        assert np.allclose(same[1].poses[i], T_RIGHT_LEFT @ boards[i], atol=1e-9)


def calibrated(board, boards, T_view, turned):
    """A view that saw all corners of boards, some of them numbered from the other end."""
    turn, count = half_turn(board), len(board.points)
    poses = np.array([T_view @ T @ (turn if i in turned else np.eye(4))
                      for i, T in enumerate(boards)])  # fmt: skip
    numbers = [np.arange(count)[:: -1 if i in turned else 1] for i in range(len(boards))]
    instant, none = np.repeat(np.arange(len(boards)), count), np.zeros((count * len(boards), 2))
    corners = Corners(instant, 0 * instant, np.concatenate(numbers), none, none[:, None])
    state = State((), (), np.eye(4)[None], poses)
    adjusted = Adjusted(state, none, 1.0, np.zeros((0, 0)), True)
    view = View("left", (10, 10), {}, Path("left"))
    return ViewCalibration(view, 0, Choice(LensShape("equidistant"), {}), adjusted, corners)


OWN = rigid(axis_angle(unit(np.array([0.3, 1.0, 0.2])), 2.5), [0.4, -0.1, 1.9])
"""The right camera's board in the frame of the left one's."""


def before_fixed_boards(boards, name="right"):
    right = {i: T_RIGHT_LEFT @ T @ OWN for i, T in enumerate(boards)}
    return [SimpleNamespace(poses=dict(enumerate(boards)), view=SimpleNamespace(name="left")),
            SimpleNamespace(poses=right, view=SimpleNamespace(name=name))]  # fmt: skip


def test_cameras_that_never_see_one_board_together(boards):
    cameras, own = fixed_boards(before_fixed_boards(boards), parse_board("charuco:5x7:0.03:0.02"))
    assert np.allclose(cameras[1], T_RIGHT_LEFT, atol=1e-8)
    assert np.allclose(own[1], OWN, atol=1e-8)


def test_memory_of_many_pictures_before_fixed_boards(boards):
    pair = before_fixed_boards(np.concatenate([boards] * 3))
    with peak_below(20e6):  # 2775 pairs
        fixed_boards(pair, parse_board("charuco:5x7:0.03:0.02"))


def test_fixed_boards_that_determine_nothing(boards):
    charuco = parse_board("charuco:5x7:0.03:0.02")
    with pytest.raises(InputError, match="after half a turn"):
        fixed_boards(before_fixed_boards(boards), parse_board("checkerboard:5x7:0.03"))
    with pytest.raises(InputError, match="only 2 instants"):
        fixed_boards(before_fixed_boards(boards[:2]), charuco)
    turned = [rigid(axis_angle(np.array([0.0, 0.0, 1.0]), 0.1 * i), [0.1 * i, 0.0, 1.0])
              for i in range(9)]  # fmt: skip
    with pytest.raises(InputError, match="hardly turned"):
        fixed_boards(before_fixed_boards(turned), charuco)
    pair = before_fixed_boards(boards)
    pair[1].poses = {i: pair[1].poses[(i + 3) % len(boards)] for i in pair[1].poses}
    with pytest.raises(InputError, match="right: its board moved"):
        fixed_boards(pair, charuco)
