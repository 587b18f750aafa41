"""Boards against OpenCV's own drawing and detectors."""

import cv2
import numpy as np
import pytest

from egocap.boards.board import Board, parse_board
from egocap.errors import InputError


def drawn(board, pixels_per_metre):
    """The board as a picture, whose pixel (0, 0) is the pattern's corner."""
    width, height = (round(side * pixels_per_metre) for side in board.size)
    picture = np.full((height, width), 255, np.uint8)
    for x, y, w, h in np.rint(board.black() * pixels_per_metre).astype(int).tolist():
        picture[y : y + h, x : x + w] = 0
    return picture


def test_charuco_is_opencvs():
    board = parse_board("charuco:5x7:0.04:0.03")
    theirs = cv2.aruco.CharucoBoard((5, 7), 0.04, 0.03, board.cv_dictionary)
    assert np.array_equal(drawn(board, 3000), theirs.generateImage((600, 840)))
    assert np.allclose(theirs.getChessboardCorners(), board.points, atol=1e-6)
    for number, corners in board.markers.items():
        assert np.allclose(theirs.getObjPoints()[number][:, :2], corners, atol=1e-6)


def test_opencv_finds_the_corners_of_a_checkerboard():
    board = parse_board("checkerboard:9x6:0.02")
    picture = cv2.copyMakeBorder(drawn(board, 2000), 40, 40, 40, 40, cv2.BORDER_CONSTANT, value=255)
    found, corners = cv2.findChessboardCornersSB(picture, board.grid)
    assert found
    expected = board.points[:, :2] * 2000 + 40 - 0.5
    apart = np.linalg.norm(corners.reshape(-1, 1, 2) - expected, axis=-1)
    assert apart.min(1).max() < 0.2


def test_opencv_finds_the_tags_of_an_aprilgrid():
    board = parse_board("aprilgrid:3x2:0.03:0.3")
    picture = cv2.copyMakeBorder(drawn(board, 4000), 40, 40, 40, 40, cv2.BORDER_CONSTANT, value=255)
    settings = cv2.aruco.DetectorParameters()
    settings.markerBorderBits = 2
    corners, numbers, _ = cv2.aruco.ArucoDetector(board.cv_dictionary, settings).detectMarkers(
        picture
    )
    assert sorted(np.ravel(numbers)) == list(range(6))
    for number, found in zip(np.ravel(numbers), corners, strict=True):
        turned = np.roll(board.markers[int(number)], 2, axis=0)  # Kalibr's print against OpenCV's
        expected = turned * 4000 + 40 - 0.5
        assert np.abs(found.reshape(4, 2) - expected).max() < 8.0  # gap squares touch the corners
    assert board.markers[0][0, 1] > board.markers[3][0, 1]  # tag 0 is in the bottom row


@pytest.mark.parametrize("text", ["charuco:5x7:0.04:0.03", "checkerboard:4x5:0.02",
                                  "aprilgrid:3x2:0.05:0.3"])  # fmt: skip
def test_quadrants_of_every_corner_have_the_stated_polarity(text):
    board = parse_board(text)
    picture = drawn(board, 4000)
    step = 0.3 * board.reach
    for point, polarity in zip(board.points[:, :2], board.polarity, strict=True):
        for sx, sy in ((1, 1), (-1, -1), (1, -1), (-1, 1)):
            x, y = ((point + step * np.array([sx, sy])) * 4000).astype(int)
            assert (picture[y, x] == 0) == (sx * sy * polarity > 0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("chessboard:5x7:0.03", "unknown board"),
        ("charuco:5x7:0.03", "cannot read"),
        ("charuco:5x7:0.03:0.04", "markers smaller than the squares"),
        ("checkerboard:5x7:32.5", "32.5 mm are 0.0325"),
        ("checkerboard:1x7:0.03", "3 to 100"),
        ("charuco:5x7:0.04:0.03:9X9_50", "unknown dictionary"),
        ("aprilgrid:6x6:0.03:30", "gap over tag size"),
        ("charuco:20x20:0.04:0.03:4X4_50", "at most 50 markers: 5 rows at 20 columns"),
        ("charuco:50x50:0.04:0.03", "at most 1000 markers: 40 rows at 50 columns"),
        ("aprilgrid:30x30:0.03:0.3", "at most 587 markers: 19 rows at 30 columns"),
    ],
)
def test_wrong_descriptions_say_what_is_valid(text, said):
    with pytest.raises(InputError, match=said):
        parse_board(text)


@pytest.mark.parametrize("kind", ["charuco", "aprilgrid"])
def test_boards_without_the_size_of_markers(kind):
    with pytest.raises(InputError, match=r"markers smaller|gap over tag"):
        Board(kind, 5, 7, 0.03)
    with pytest.raises(InputError, match="unknown dictionary ''"):
        Board(kind, 5, 7, 0.03, 0.02 if kind == "charuco" else 0.3)


@pytest.mark.parametrize("text", ["charuco:3x67:0.04:0.03:4X4_100", "charuco:50x40:0.04:0.03",
                                  "aprilgrid:30x19:0.03:0.3"])  # fmt: skip
def test_the_largest_boards_of_a_dictionary_can_be_drawn(text):
    board = parse_board(text)
    size = len(board.cv_dictionary.bytesList)
    assert len(board.markers) <= size < len(board.markers) + board.columns
    assert np.isfinite(board.black()).all()


@pytest.mark.parametrize("text", ["checkerboard:9x6:0.025", "charuco:5x7:0.0325:0.024:6X6_250",
                                  "aprilgrid:6x6:0.03:0.3"])  # fmt: skip
def test_text_round_trip(text):
    assert parse_board(str(parse_board(text))) == parse_board(text)
