"""Scores against hand-made predictions."""

import numpy as np
import pytest
import torch

from egocap.detect.network import CONFIGS, build_network
from egocap.detect.train.examples import HIDDEN, SEEN
from egocap.detect.train.validation import Predictions, auroc, predict, score, sigma_bias
from tests.egocap.detect.synthetic_store import store


def predictions(off, state=None, log_sigma=0.0, visible=0.9):
    shape = off.shape[:2]
    state = np.full(shape, SEEN) if state is None else state
    return Predictions(
        off, np.full(shape, log_sigma), np.full(shape, visible), state, np.full(shape, 2.0)
    )


def test_perfect_predictions_score_a_hundred():
    found = score(predictions(np.zeros((5, 18, 2))))
    assert (found.pck, found.auc, found.error_px) == (100.0, 100.0, 0.0)


def test_errors_are_in_camera_pixels():
    off = np.zeros((5, 18, 2))
    off[..., 0] = 5.0  # canonical; 10 camera pixels
    found = score(predictions(off))
    assert found.error_px == found.median_px == 10.0
    assert found.auc == pytest.approx(50.0, abs=1.0) and found.pck == 100.0


def test_visible_labels_count_and_in_view_ones_apart():
    off = np.zeros((4, 18, 2))
    off[:, 9:] = 100.0
    state = np.full((4, 18), SEEN)
    state[:, 9:] = HIDDEN
    found = score(predictions(off, state))
    assert found.pck == 100.0 and found.pck_in_view == 50.0


def test_sigma_bias_makes_normalised_errors_one():
    rng = np.random.default_rng(0)
    off = rng.normal(0, 3.0, (400, 18, 2))
    found = predictions(off, log_sigma=0.0)
    assert score(found).normalised_error == pytest.approx(3.0, rel=0.02)
    bias = sigma_bias(found)
    np.testing.assert_allclose(bias, np.log(3.0), atol=0.1)
    fixed = Predictions(
        off, found.log_sigma + bias, found.visible, found.state, found.magnification
    )
    assert score(fixed).normalised_error == pytest.approx(1.0, abs=0.01)


def test_auroc():
    assert auroc(np.array([3.0, 4.0]), np.array([1.0, 2.0])) == 1.0
    assert auroc(np.array([1.0]), np.array([1.0])) == 0.5
    assert auroc(np.array([1.0, 4.0]), np.array([2.0, 3.0])) == 0.5
    assert np.isnan(auroc(np.array([]), np.array([1.0])))


def test_any_batch_size_predicts_the_same():
    torch.manual_seed(0)
    network, views = build_network(CONFIGS["tiny"]).train(), store(6, 0)
    whole, split = (predict(network, views, np.arange(12), batch) for batch in (12, 5))
    assert network.training
    np.testing.assert_allclose(whole.log_sigma, split.log_sigma, atol=0.05)  # bfloat16
    assert whole.state.shape == (12, 18)
