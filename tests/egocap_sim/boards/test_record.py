from dataclasses import replace

import numpy as np
import pytest

from egocap.boards.board import parse_board
from egocap.errors import InputError
from egocap_sim.boards.record import record_board
from egocap_sim.boards.settings import BoardCamera, BoardRecording
from egocap_sim.scene.rig_sampler import sample_rig


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rate": -5.0}, r"--rate -5 \(valid: a number from 0"),
        ({"bend_m": float("nan")}, "--bend-m nan"),
        ({"seed": -1}, "--seed -1"),
        ({"camera": BoardCamera(samples=0)}, "--samples 0"),
        ({"camera": BoardCamera(jpeg=200)}, r"--jpeg 200 \(valid: 1 to 100"),
        ({"camera": BoardCamera(noise=float("nan"))}, "--noise nan"),
    ],
)
def test_impossible_numbers_are_refused_before_anything_is_written(tmp_path, changes, message):
    rig = sample_rig(np.random.default_rng(1))
    settings = replace(BoardRecording(count=1), **changes)
    with pytest.raises(InputError, match=message):
        record_board(parse_board("checkerboard:5x7:0.03"), rig, settings, tmp_path / "out")
    assert not (tmp_path / "out").exists()
