"""Errors from synthetic corners: within their standard deviations; what makes them smaller."""

import numpy as np
import pytest

from egocap.boards.board import parse_board
from egocap_eval.calibration.lenses import stereo_rig, study_lenses
from egocap_eval.calibration.synthetic import Fixed, fixed_boards, timed

BOARD = parse_board("charuco:5x7:0.0325:0.024")


@pytest.fixture(scope="module")
def rig():
    return stereo_rig("equidistant", study_lenses(None)["equidistant"])


def test_poses_before_fixed_boards(rig):
    """Unbiased over ten recordings; more turning, and lenses known before, are more exact."""
    found = [fixed_boards(rig, BOARD, Fixed(20, 20, 0.3), np.random.default_rng(i))
             for i in range(10)]  # fmt: skip
    normalised = np.sqrt(np.mean([f["normalised"] ** 2 for f in found]))
    assert 0.75 < normalised < 1.3
    turned = fixed_boards(rig, BOARD, Fixed(20, 40, 0.3), np.random.default_rng(0))
    assert turned["degrees_std"] < 0.7 * found[0]["degrees_std"]
    assert all(f["degrees_std_known_lens"] < f["degrees_std"] for f in found)


def test_times_of_a_moving_board(rig):
    for name, time in timed(rig, BOARD, 12, np.random.default_rng(0)).items():
        assert time["std_ms"] < 0.2, name
        assert abs(time["error_ms"]) < 4.0 * time["std_ms"] + 0.1, name
