"""The picture of the image model, drawn for a made-up sequence of one frame."""

from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from egocap.body.gaussians import GaussianBody
from egocap.body.proportions import Proportions
from egocap.cameras.rig_files import load_rig
from egocap.errors import InputError, MachineError
from egocap.view.model import draw_model
from egocap.view.render import view_model


class OneFrame:
    """What `draw_model` needs of a sequence."""

    manifest = SimpleNamespace(name="made up")
    rig = load_rig(Path(__file__).parents[3] / "scenes/rigs/egorig1.toml")
    body = Proportions.from_lengths(1.75)

    def frame(self, _):
        half = np.zeros((40, 48, 3), np.uint8)
        half[:, 20:] = (30, 90, 160)
        return SimpleNamespace(images=(half, half))


def test_a_picture_is_drawn(tmp_path):
    out = tmp_path / "deep" / "picture.png"
    summary = draw_model(OneFrame(), 0, np.zeros(37), out, width=24, height=24)
    drawn = cv2.imread(str(out))
    assert drawn.shape[0] > 500 and drawn.shape[1] > 1500 and drawn.std() > 20
    assert summary["covered_pixels"] > 50
    assert abs(summary["energy"]) <= summary["covered_pixels"]


def test_a_given_body_keeps_its_colours(tmp_path):
    body = GaussianBody.from_proportions(OneFrame.body)
    summary = draw_model(OneFrame(), 0, np.zeros(37), tmp_path / "a.png", body, 16, 16)
    assert np.isfinite(summary["energy"])


def test_an_unwritable_place_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    body = GaussianBody.from_proportions(OneFrame.body)
    with pytest.raises(MachineError, match="cannot write"):
        draw_model(OneFrame(), 0, np.zeros(37), tmp_path / "file" / "a.png", body, 16, 16)


def test_wrong_words_are_refused(tmp_path):
    with pytest.raises(InputError, match="no format"):
        view_model(tmp_path, 0, tmp_path / "a.bmp", None, None, (64, 64))
    with pytest.raises(InputError, match="size"):
        view_model(tmp_path, 0, tmp_path / "a.png", None, None, (4, 64))
