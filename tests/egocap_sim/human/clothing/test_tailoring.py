"""Painted cloth: compiled loops against the same in numpy."""

import numpy as np
import pytest

from egocap_sim.human.body.body_chart import TORSO
from egocap_sim.human.clothing import tailoring
from egocap_sim.human.clothing.panels import Panel

PANEL = Panel(TORSO, 0, 0, 64, 48, 1.5, 0.9)


def test_slopes_are_differences_of_shifted_ridges():
    rng = np.random.default_rng(0)
    noise = rng.uniform(-1, 1, (48, 57)).astype(np.float32)
    shift = rng.integers(-200, 200, 48)
    ridge = np.array([1 - 2 * np.abs(row[(np.arange(64) + s) % 57])
                      for row, s in zip(noise, shift, strict=True)])  # fmt: skip
    expected = 0.3 * np.diff(ridge, axis=0, append=ridge[-1:])
    assert tailoring._slopes(noise, shift, 64, 0.3) == pytest.approx(expected, abs=1e-6)


def test_a_tile_repeats_without_a_seam():
    tile = np.random.default_rng(0).integers(0, 256, (16, 16, 3), np.uint8)
    panel = Panel(TORSO, 0, 0, 1120, 48, 1.5, 0.9)  # a turn is 1000 columns
    laid = tailoring.lay_tile(panel, tile, 0.24)
    assert np.array_equal(laid[:, :120], laid[:, 1000:])
    assert set(map(tuple, laid.reshape(-1, 3))) <= set(
        map(tuple, tile.reshape(-1, 3).astype(float))
    )


def test_shadow_is_where_the_light_is_missing():
    along = np.random.default_rng(0).uniform(PANEL.bottom, PANEL.top, 3000)
    turn = np.random.default_rng(1).uniform(0, 1, 3000)
    shade = tailoring.shadow(PANEL, turn, along, (along > 1.2).astype(float))
    assert shade.shape == (48, 64)
    assert shade[:16] == pytest.approx(1.0, abs=1e-6)
    assert shade[32:] == pytest.approx(1 - tailoring.SHADE, abs=1e-6)
