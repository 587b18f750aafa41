"""The card says what the files say, and refuses files of different weights."""

from pathlib import Path

import numpy as np
import pytest
import torch

from egocap.detect.calibration import Calibration
from egocap.detect.network import CONFIGS, build_network
from egocap.detect.weights import open_weights, save_weights
from egocap.errors import FileError
from egocap_eval.detection.detector import Scored, summary
from egocap_eval.detection.model_card import card
from egocap_eval.harness.result_file import load_result, save_result

TRAINING = {"command": "egocap train data", "views": 1234, "calibration": {"views": 560}}


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("card")
    torch.manual_seed(0)
    weights, result = folder / "w.safetensors", folder / "r.json"
    save_weights(weights, build_network(CONFIGS["tiny"]), TRAINING, Calibration(0.8))
    shape = (4, 2, 18)
    errors = np.random.default_rng(0).rayleigh(3.0, shape)
    yes = np.ones(shape, bool)
    scored = Scored(errors, np.full(shape, 3.0), np.full(shape, 0.8), yes, yes, yes)
    save_result(result, summary({"walk": scored}), "egocap-eval detector",
                config={"weights": open_weights(weights).sha256})  # fmt: skip
    return weights, result


def test_the_card_holds_what_was_measured(files):
    weights, result = open_weights(files[0]), load_result(files[1])
    text = card(weights, result)
    pck = f"{result['result']['visible']['pck20']:.1f}"
    for words in (weights.sha256, "egocap train data", "1234", "views: 560", pck, "89.5",
                  "On 4 validation frames", "What it cannot do"):  # fmt: skip
        assert words in text, words


def test_a_result_of_other_weights_is_refused(files, tmp_path):
    other = tmp_path / "o.safetensors"
    save_weights(other, build_network(CONFIGS["tiny"]), TRAINING)
    with pytest.raises(FileError, match="other weights"):
        card(open_weights(other), load_result(files[1]))


def test_other_rigs_have_a_row_each_and_must_be_of_the_same_weights(files):
    weights, result = open_weights(files[0]), load_result(files[1])
    pck = f"{result['result']['visible']['pck20']:.1f}"
    assert f"| glasses | 4 | {pck} |" in card(weights, result, {"glasses": result})
    wrong = {**result, "config": {"weights": "0"}}
    with pytest.raises(FileError, match="other weights"):
        card(weights, result, {"glasses": wrong})
