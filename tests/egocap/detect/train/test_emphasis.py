"""Sequences that the initial weights get wrong are drawn more often."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from egocap.detect.network import build_network, config_named
from egocap.detect.train.emphasis import MOST, difficulty, emphasised
from egocap.detect.train.examples import HIDDEN, OUTSIDE, SEEN, ViewStore, build_store
from egocap.detect.train.validation import Predictions, predict


def test_difficulty_of_a_view():
    state = np.full((3, 18), OUTSIDE)
    state[0, 0], state[0, 1] = SEEN, HIDDEN
    state[1, 0] = SEEN
    off = np.zeros((3, 18, 2))
    off[0, 0], off[1, 0] = (6.0, 8.0), (300.0, 0.0)  # canonical px; magnified to 15 and 450 px
    magnification = np.full((3, 18), 1.5)
    found = Predictions(off, np.zeros((3, 18)), np.zeros((3, 18)), state, magnification)
    np.testing.assert_allclose(difficulty(found), [0.75 / 1.5, 1.0, 0.0])


@pytest.fixture
def easy_and_hard(tiny_sequence, tmp_path):
    """A network, and a sequence labelled as it sees it beside the same labelled elsewhere."""
    torch.manual_seed(3)
    network = build_network(config_named("tiny"))
    (views,) = build_store([tiny_sequence], network.config.view, tmp_path).sequences
    views = replace(views, state=np.full_like(views.state, SEEN),
                    magnification=np.full_like(views.magnification, 5.0))  # fmt: skip
    off = predict(network, ViewStore((views,)), np.arange(len(views))).off
    easy = replace(views, points=(views.points + off).astype(np.float32))
    return network, ViewStore((easy, replace(easy, points=easy.points + 30.0)))


def test_sequences_weigh_by_their_difficulty(easy_and_hard):
    network, store = easy_and_hard
    even = emphasised(store, network, 0.0)
    assert even.odds == (1.0, 1.0)
    easy, hard = emphasised(store, network, 1.0).odds
    assert easy == pytest.approx(1.0 / MOST) and hard == pytest.approx(2.0, rel=0.01)
    easy, hard = emphasised(replace(store, odds=(8.0, 1.0)), network, 3.0).odds
    assert easy == pytest.approx(8.0 / MOST) and hard == pytest.approx(MOST)


def test_weights_are_the_same_each_time(easy_and_hard):
    network, store = easy_and_hard
    network.train()
    first = emphasised(store, network, 0.7)
    assert network.training and emphasised(store, network, 0.7).odds == first.odds
