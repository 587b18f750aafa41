"""The bend of a board from the residuals of an adjustment that took it for flat."""

import numpy as np
import pytest

from egocap.calibration.adjustment import adjust
from egocap.calibration.flatness import bend, bend_basis
from egocap.calibration.lens_shape import LensShape
from egocap.calibration.model_choice import with_shape
from egocap.calibration.start import start_view
from egocap.calibration.state import Corners, joined
from egocap.geometry import transform

SIZE = (1280, 1024)


@pytest.mark.parametrize("height", [(0.0, 0.0, 0.0), (0.003, 0.0, 0.001)])
def test_bend_is_found_within_its_deviation(board, rig, boards, height):
    points = board.points + [0.0, 0.0, 1.0] * (bend_basis(board) @ height)[:, None]
    corners = seen(points, rig.cameras[0], boards)
    started = start_view(corners, board.points, SIZE)
    state = with_shape(started.state, LensShape("kannala_brandt"), board.points)
    found, covariance = bend(adjust(state, corners, board.points), corners, board)
    # one step from a flat board: a tenth of the bend is left to the lens and the poses
    off = found - height
    deviation = np.sqrt(np.diag(covariance))
    assert np.all(np.abs(off) < 4 * deviation + 0.1 * np.abs(height).max())
    assert deviation.max() < 3e-4


def seen(points, camera, boards):
    rng, parts = np.random.default_rng(4), []
    for i, T in enumerate(boards):
        pixels, valid = camera.project(transform(T, points))
        at = np.flatnonzero(valid)
        if len(at) >= 6:
            noisy = pixels[at] + 0.05 * rng.standard_normal((len(at), 2))
            parts.append(Corners(np.full(len(at), i), np.zeros(len(at), int), at, noisy,
                                 np.tile(np.eye(2), (len(at), 1, 1))))  # fmt: skip
    return joined(parts)
