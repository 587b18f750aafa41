"""Ideal corners of boards before a rig, by the cameras' own projection."""

import numpy as np
import pytest

from egocap.boards.board import parse_board
from egocap.calibration.state import Corners, joined
from egocap.cameras.camera import Camera
from egocap.cameras.rig import Mount, Rig
from egocap.geometry import inverse, rigid, transform
from egocap_sim.boards.path import draw_path

SIZE = (1280, 1024)


@pytest.fixture(scope="session")
def board():
    return parse_board("checkerboard:7x6:0.03")


@pytest.fixture(scope="session")
def rig():
    """A Kannala-Brandt and a Scaramuzza camera, 0.3 m apart."""
    first = Camera("kannala_brandt", *SIZE, (642.0, 509.0), ((400.0, 0.0), (0.0, 401.0)),
                   (0.02, -0.008, 0.002, -0.0004))  # fmt: skip
    second = Camera("ocam", *SIZE, (636.0, 515.0), ((1.0, 2e-4), (2e-4, 0.9995)),
                    (-410.0, 0.0, 6e-4, -3e-7, 4e-10))  # fmt: skip
    looking = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    mounts = (Mount("left", first, rigid(looking, [0.2, 0.15, 0.1])),
              Mount("right", second, rigid(looking, [0.2, -0.15, 0.1])))  # fmt: skip
    return Rig("ideal", mounts)


@pytest.fixture(scope="session")
def boards(board, rig):
    """T_rig_board of 25 pictures, in the first camera's frame."""
    path = draw_path(board, rig, 25, np.random.default_rng(3))
    return inverse(rig.T_head_camera[0]) @ path.T_rig_board(path.times)


@pytest.fixture(scope="session")
def corners(board, rig, boards):
    """Corners of both views with 0.1 px of noise."""
    rng, parts = np.random.default_rng(4), []
    T_first_head = inverse(rig.T_head_camera[0])
    for v, mount in enumerate(rig.mounts):
        T_view = inverse(T_first_head @ mount.T_head_camera)
        for i, T in enumerate(boards):
            pixels, valid = mount.camera.project(transform(T_view @ T, board.points))
            at = np.flatnonzero(valid)
            if len(at) >= 6:
                seen = pixels[at] + 0.1 * rng.standard_normal((len(at), 2))
                parts.append(Corners(np.full(len(at), i), np.full(len(at), v), at, seen,
                                     np.tile(np.eye(2), (len(at), 1, 1))))  # fmt: skip
    return joined(parts)
