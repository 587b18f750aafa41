"""Checkerboards cut off by the image or washed out by glare: their corners against the truth."""

import json

import cv2
import numpy as np
import pytest

from egocap.boards.board import parse_board
from egocap.calibration.detection import find_board
from egocap.calibration.partial_board import find_part
from egocap.cameras.camera import Camera
from egocap.cameras.rig import Mount, Rig
from egocap.geometry import inverse, rigid, transform
from egocap_sim.boards.record import TRUTH, record_board
from egocap_sim.boards.settings import BoardCamera, BoardRecording

BOARD = parse_board("checkerboard:6x8:0.03")  # 5 x 7 inner corners
LENS = Camera("kannala_brandt", 1032, 778, (520.0, 384.0), ((238.0, 0.0), (0.0, 238.5)),
              (0.01, -0.004, 0.001, -0.0002), np.deg2rad(93.0))  # fmt: skip
LOOKING = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@pytest.fixture(scope="module")
def shots(tmp_path_factory):
    """Pictures with the true pixels (35, 2) of the corners and whether they are in view."""
    folder = tmp_path_factory.mktemp("partial") / "board"
    rig = Rig("one", (Mount("left", LENS, rigid(LOOKING, [0.2, 0.0, 0.1])),))
    camera = BoardCamera(samples=2, exposures=1)
    record_board(BOARD, rig, BoardRecording(count=15, seed=1, camera=camera), folder)
    poses = np.array(json.loads((folder / TRUTH).read_text())["T_rig_board"])
    found = []
    for path, T in zip(sorted((folder / "left").iterdir()), poses, strict=True):
        seen = LENS.project(transform(inverse(rig.T_head_camera[0]) @ T, BOARD.points))
        found.append((cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), *seen))
    return found


def error(found, pixels):
    """Largest distance [px] to the true corners; half a turn of the board is not told apart."""
    order = found.index, len(BOARD.points) - 1 - found.index
    return min(np.linalg.norm(pixels[at] - found.pixels, axis=1).max() for at in order)


@pytest.mark.parametrize("shot", [11, 12])  # glare near the rim; cut off by the image
def test_boards_that_the_detectors_of_whole_boards_miss(shots, shot):
    picture, pixels, valid = shots[shot]
    assert not len(find_board(picture, BOARD))
    found = find_part(picture, BOARD, LENS)
    assert len(found) > 0.8 * valid.sum()
    assert error(found, pixels) < 0.3


@pytest.mark.parametrize("shot", [5, 7, 8])
def test_a_part_placed_on_the_board_by_what_is_in_view(shots, shot):
    """By corners alone, the last is placed two squares off."""
    picture, pixels, _ = shots[shot]
    cut = picture.copy()
    cut[:, : int(np.quantile(pixels[:, 0], 0.25))] = 0
    found = find_part(cut, BOARD, LENS)
    assert len(found) >= 20
    assert error(found, pixels) < 0.3


def test_a_part_that_fits_two_places_is_refused(shots):
    """Left and right ends of the board are hidden: nothing tells how much of each."""
    picture, pixels, _ = shots[5]
    left, right = np.quantile(pixels[:, 0], [0.22, 0.78]).astype(int)
    cut = picture.copy()
    cut[:, :left] = cut[:, right:] = 0
    assert not len(find_part(cut, BOARD, LENS))


def test_no_board_in_a_picture_without_one(shots):
    picture, pixels, _ = shots[3]
    (left, top), (right, bottom) = np.rint(pixels.min(0) - 60), np.rint(pixels.max(0) + 60)
    empty = picture.copy()
    empty[int(max(top, 0)) : int(bottom), int(max(left, 0)) : int(right)] = 90
    assert not len(find_part(empty, BOARD, LENS))
