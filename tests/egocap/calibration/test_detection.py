"""AprilGrids as Kalibr prints them, and with OpenCV's tags, through lenses of any field."""

from functools import cache

import cv2
import numpy as np
import pytest

from egocap.boards.board import TAG_BORDER, parse_board
from egocap.calibration.detection import anchor_points, find_markers
from egocap.cameras.camera import Camera
from egocap.geometry import axis_angle, rigid, unit

CODES = (0xD5D628584, 0xD97F18B49, 0xDD280910E, 0xE479E9C98, 0xEBCBCA822, 0xF31DAB3AC,
         0x056A5D085, 0x10652E1D4, 0x22B1DFEAD, 0x265AD0472, 0x34FE91B86, 0x3FF962CD5)  # fmt: skip
"""The first tags of 36h11, as Kalibr lists them."""
BOARD = parse_board("aprilgrid:4x3:0.1:0.3")
MARGIN = 60  # pixels of 1 mm around the pattern
WIDE = Camera("equidistant", 1280, 1280, (639.5, 639.5), ((330.0, 0.0), (0.0, 330.0)), (), 1.9)


def kalibr_tag(code):
    """The 10 x 10 cells of a tag, 1 = black, by the arithmetic of kalibr_create_target_pdf."""
    cells = np.array([[not code & (1 << (6 * i + j)) for j in range(6)] for i in range(6)])
    return np.pad(np.rot90(cells, 2), TAG_BORDER, constant_values=1)


def opencv_tag(number):
    size = 6 + 2 * TAG_BORDER
    return BOARD.cv_dictionary.generateImageMarker(number, size, borderBits=TAG_BORDER) < 128


def grid(tags):
    """A picture of an AprilGrid of 4 x 3 tags of 100 mm, 1 mm a pixel, tag 0 at the bottom left."""
    picture = np.full((420 + 2 * MARGIN, 550 + 2 * MARGIN), 255, np.uint8)
    for y in range(MARGIN, MARGIN + 4 * 130, 130):
        for x in range(MARGIN, MARGIN + 5 * 130, 130):
            picture[y : y + 30, x : x + 30] = 0
    for number, cells in enumerate(tags):
        x = MARGIN + 30 + 130 * (number % 4)
        y = MARGIN + 30 + 130 * (2 - number // 4)
        picture[y : y + 100, x : x + 100] = np.where(np.kron(cells, np.ones((10, 10))), 0, 255)
    return picture


PRINTS = {
    "kalibr": grid([kalibr_tag(code) for code in CODES]),
    "opencv": grid([opencv_tag(number) for number in range(12)]),
}


@cache
def rays():
    """Of every pixel of WIDE."""
    rows, columns = np.indices((WIDE.height, WIDE.width), dtype=float)
    return WIDE.ray(np.stack([columns, rows], -1))[0]


def photographed(sheet, T_camera_board):
    R, t = T_camera_board[:3, :3], T_camera_board[:3, 3]
    ways, origin = rays() @ R, -R.T @ t
    along = -origin[2] / ways[..., 2]
    at = (1000 * (origin + along[..., None] * ways) + MARGIN - 0.5).astype(np.float32)
    seen = cv2.remap(sheet, at[..., 0], at[..., 1], cv2.INTER_AREA, borderValue=128)
    return cv2.GaussianBlur(np.where(along > 0, seen, 128).astype(np.uint8), (0, 0), 0.7)


def test_boards_are_drawn_as_kalibr_prints_them():
    black = np.full_like(PRINTS["kalibr"], 255)
    for x, y, w, h in np.rint(1000 * BOARD.black() + [MARGIN, MARGIN, 0, 0]).astype(int):
        black[y : y + h, x : x + w] = 0
    assert np.array_equal(black, PRINTS["kalibr"])


@pytest.mark.parametrize("name", PRINTS)
def test_corners_of_both_prints(name):
    found = find_markers(PRINTS[name], BOARD)
    expected = 1000 * anchor_points(BOARD)[found.index, :2] + MARGIN - 0.5
    assert len(found) == 48
    assert np.abs(found.pixels - expected).max() < 0.5


@pytest.mark.parametrize("name", PRINTS)
@pytest.mark.parametrize("tilt", [0.0, 0.7, 1.2])
@pytest.mark.parametrize("distance", [0.25, 0.4])
def test_corners_of_both_prints_through_a_fisheye(name, tilt, distance):
    for azimuth in (0.0, 2.2, 4.4):
        axis = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        R = axis_angle(axis, tilt) @ axis_angle(unit(np.array([0.2, -0.3, 1.0])), 2 * azimuth)
        sight = axis_angle(axis, tilt)[:, 2]
        T = rigid(R, distance * sight - R @ [*np.divide(BOARD.size, 2), 0.0])
        found = find_markers(photographed(PRINTS[name], T), BOARD)
        expected, _ = WIDE.project(anchor_points(BOARD)[found.index] @ R.T + T[:3, 3])
        assert len(found) >= 12
        assert np.median(np.linalg.norm(found.pixels - expected, axis=1)) < 6.0


def test_a_single_tag_is_read_as_kalibrs():
    sheet = PRINTS["kalibr"].copy()
    sheet[:, MARGIN + 145 :] = 255
    sheet[: MARGIN + 275] = 255
    found = find_markers(sheet, BOARD)
    expected = 1000 * anchor_points(BOARD)[found.index, :2] + MARGIN - 0.5
    assert len(found) == 4
    assert np.abs(found.pixels - expected).max() < 0.5
