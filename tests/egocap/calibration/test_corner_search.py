"""Corners of a picture count only if they determine a pose."""

from egocap.calibration.corner_search import spans_plane


def test_corners_on_a_line_do_not_span_the_board(board):
    columns, _ = board.grid
    assert not spans_plane(board.points[:columns])
    assert spans_plane(board.points[: 2 * columns])
