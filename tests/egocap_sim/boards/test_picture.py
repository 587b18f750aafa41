"""A rendered corner lies where the camera projects it, by a measure of its own."""

import numpy as np
import pytest

from egocap.boards.board import parse_board
from egocap.cameras.camera import Camera
from egocap.geometry import rigid, transform
from egocap_sim.boards.path import draw_path
from egocap_sim.boards.picture import Shot, take
from egocap_sim.boards.settings import BoardCamera
from egocap_sim.boards.sheet import print_sheet

CLEAN = BoardCamera(blur_px=0.8, noise=0.0, jpeg=100, vignetting=0.0, samples=4, exposures=1)
LIGHT = np.array([0.9, 0.0, 0.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("middle", [(0.0, 0.0, 0.25), (0.24, 0.0, 0.05)])
def test_saddle_point_lies_at_the_projected_corner(middle):
    """About a corner the first moments of grey vanish, and its mean is between black and white."""
    board = parse_board("checkerboard:4x4:0.03")
    camera = Camera("equidistant", 640, 640, (319.5, 319.5), ((200.0, 0.0), (0.0, 200.0)))
    sheet = print_sheet(board, np.random.default_rng(0))
    z = np.array(middle) / np.linalg.norm(middle)
    x = np.cross([0.0, 1.0, 0.0], z)
    R = np.column_stack([x, np.cross(z, x), z])
    T = rigid(R, np.array(middle) - R @ board.points[4])
    poses = np.broadcast_to(T, (640, 1, 4, 4))
    image = take(camera, poses, Shot(sheet, np.zeros(2), LIGHT),
                 np.zeros((640, 640, 3), np.float32), CLEAN, np.random.default_rng(0))  # fmt: skip
    pixel, valid = camera.project(transform(T, board.points[4:5]))
    assert valid.all()
    linear = (image[..., 1] / 255.0) ** 2
    rows, columns = np.indices(linear.shape)
    near = np.hypot(columns - pixel[0, 0], rows - pixel[0, 1]) < 6.0
    half = (linear[near].max() + linear[near].min()) / 2
    assert linear[near].mean() == pytest.approx(half, rel=0.04)
    # odd moments vanish about the corner and nowhere else
    weight = (linear - half) * near
    away_x, away_y = columns - pixel[0, 0], rows - pixel[0, 1]
    spread = (np.abs(weight) * np.abs(away_x)).sum()
    assert abs((weight * away_x).sum()) < 0.05 * spread
    assert abs((weight * away_y).sum()) < 0.05 * spread


def test_paths_rest_where_a_camera_sees_the_board(rig_640):
    board = parse_board("charuco:5x7:0.0325:0.024")
    path = draw_path(board, rig_640, 12, np.random.default_rng(1))
    seen = []
    for T in path.T_rig_board(path.times):
        _, valid = rig_640.project(transform(T, board.points))
        seen.append(valid.mean(1).max())
    assert min(seen) > 0.45
    moved = path.T_rig_board(path.times + 1e-4)[:, :3, 3] - path.T_rig_board(path.times)[:, :3, 3]
    assert np.linalg.norm(moved, axis=1).max() / 1e-4 < 0.1  # m/s: the hand rests


@pytest.fixture
def rig_640():
    from egocap.cameras.rig_files import load_rig
    from egocap_sim.core.resources import rig_file

    return load_rig(rig_file("egorig1")).resized(640, 512)
