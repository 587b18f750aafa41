"""Camera poses from boards seen by both, in spite of wrong ones; too few of them."""

from types import SimpleNamespace

import numpy as np
import pytest

from egocap.boards.board import parse_board
from egocap.calibration.stereo import half_turn, start_poses
from egocap.errors import InputError
from egocap.geometry import axis_angle, rigid, transform

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


def test_half_turn_maps_a_symmetric_board_onto_itself():
    board = parse_board("checkerboard:5x7:0.03")
    turned = transform(half_turn(board), board.points)
    assert np.allclose(turned, board.points[::-1])
