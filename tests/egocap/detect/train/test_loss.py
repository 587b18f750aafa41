"""Losses are least at the truth."""

import numpy as np
import pytest
import torch

from egocap.body.labels import LABELS
from egocap.detect.heatmaps import targets
from egocap.detect.train.config import LossConfig
from egocap.detect.train.examples import HIDDEN, OUTSIDE, SEEN, UNKNOWN
from egocap.detect.train.loss import label_weights, losses, spread_loss

CONFIG = LossConfig()


def perfect(points, state):
    sigma = torch.where(state == SEEN, CONFIG.seen_cells, CONFIG.hidden_cells)
    heat = torch.log(targets(points, (14, 16), 4, sigma).clamp(min=1e-12))
    info = torch.zeros(*state.shape, 4)
    info.scatter_(2, state[..., None], 20.0)
    return heat, info


@pytest.fixture
def labelled():
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(4, 18, 2, generator=generator) * 30 + 12
    state = torch.randint(0, 3, (4, 18), generator=generator)
    return points, state


def test_perfect_answers_cost_nothing(labelled):
    points, state = labelled
    found = losses(*perfect(points, state), points, state, 4, CONFIG)
    assert float(found.heat) == pytest.approx(0.0, abs=1e-4)
    assert float(found.place) < 0.01
    assert float(found.visibility) < 1e-6


def test_shifted_maps_and_wrong_visibility_cost(labelled):
    points, state = labelled
    heat, info = perfect(points + 6.0, (state + 1) % 3)
    found = losses(heat, info, points, state, 4, CONFIG)
    assert float(found.heat) > 0.5 and float(found.place) > 0.3 and float(found.visibility) > 5


def test_labels_outside_count_for_visibility_alone(labelled):
    points, state = labelled
    heat, info = perfect(points, state)
    spoilt = torch.where((state == OUTSIDE)[..., None, None], torch.randn_like(heat), heat)
    before = losses(heat, info, points, state, 4, CONFIG)
    after = losses(spoilt, info, points, state, 4, CONFIG)
    for term in ("heat", "place", "visibility", "spread"):
        torch.testing.assert_close(getattr(before, term), getattr(after, term))


def test_spread_is_learned_from_errors():
    rng = np.random.default_rng(0)
    off = torch.from_numpy(rng.normal(0, 3.0, (500, 18, 2))).float()
    state = torch.full((500, 18), SEEN)
    values = np.linspace(0.5, 2.0, 31)
    cost = [float(spread_loss(torch.full((500, 18), float(v)), off, state)) for v in values]
    assert values[int(np.argmin(cost))] == pytest.approx(np.log(3.0), abs=0.06)


def test_weights_by_label_and_state():
    state = torch.tensor([[SEEN, HIDDEN, OUTSIDE] * 6])
    weight = label_weights(state, CONFIG)[0]
    assert weight[0] == 1.0 and weight[1] == CONFIG.hidden and (weight[2::3] == 0).all()
    foot = LABELS.index("left_foot")
    assert label_weights(torch.full((1, 18), SEEN), CONFIG)[0, foot] == CONFIG.extremities


def test_unknown_labels_count_for_nothing(labelled):
    points, state = labelled
    state = torch.where(torch.arange(18) % 3 == 0, UNKNOWN, state)
    heat, info = (a.requires_grad_() for a in perfect(points, state.clamp(max=OUTSIDE)))
    found = losses(heat + 0.1 * torch.randn_like(heat), info, points + 1.0, state, 4, CONFIG)
    found.total(CONFIG).backward()
    unknown = state == UNKNOWN
    assert not heat.grad[unknown].any() and not info.grad[unknown].any()
    assert heat.grad[state == SEEN].any() and info.grad[state == SEEN].any()
