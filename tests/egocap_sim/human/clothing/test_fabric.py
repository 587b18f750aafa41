"""Fabrics: patterns are seamless, distinct and reproducible."""

import numpy as np
import pytest

from egocap.errors import InputError
from egocap_sim.human.body.noise import smooth_noise, wrapped_noise
from egocap_sim.human.body.skin import IRISES, TONES, skin_texture, tone_color
from egocap_sim.human.clothing.fabric import PATTERNS, Fabric, fabric_texture

COLORS = ("navy", "white", "red")


@pytest.mark.parametrize("pattern", PATTERNS)
def test_patterns_tile_and_repeat(pattern):
    image = fabric_texture(Fabric(pattern, COLORS), np.random.default_rng(5))
    again = fabric_texture(Fabric(pattern, COLORS), np.random.default_rng(5))
    assert image.dtype == np.uint8
    assert image.shape == (128, 128, 3)
    assert (image == again).all()
    # Across the wrap the picture changes as it does between lines inside it.
    values = image.astype(float).mean(2)
    for axis in (0, 1):
        steps = np.abs(np.diff(values, axis=axis)).mean(1 - axis)
        wrap = np.abs(values.take(0, axis) - values.take(-1, axis)).mean()
        assert wrap <= steps.max() * 1.5 + 2


def test_wear_shows():
    new, old = (
        fabric_texture(Fabric("plain", COLORS, w), np.random.default_rng(1)).astype(float)
        for w in (0.0, 1.0)
    )
    assert old[..., 1].std() > 1.3 * new[..., 1].std()


@pytest.mark.parametrize(
    ("fabric", "message"),
    [(("tartan", COLORS), "stripes"), (("plain", ("beige", "red", "red")), "navy")],
)
def test_unknown_names_list_the_valid_ones(fabric, message):
    with pytest.raises(InputError, match=message):
        Fabric(*fabric)


def test_noise_tiles():
    noise = smooth_noise(128, 8, np.random.default_rng(0))
    assert np.abs(noise).max() <= 1
    inside = np.abs(np.diff(noise, axis=0)).max()
    assert np.abs(noise[0] - noise[-1]).max() <= inside * 1.5


def test_noise_passes_through_its_grid():
    rng = np.random.default_rng(0)
    noise = wrapped_noise(12, 30, 4, 6, rng)
    grid = np.random.default_rng(0).uniform(-1, 1, (4, 6))
    assert noise[::3, ::5] == pytest.approx(grid, abs=1e-6)
    assert noise[:, ::5][1:3] == pytest.approx(  # smooth steps of 7/27 and 20/27
        grid[0] + np.array([[7], [20]]) / 27 * (grid[1] - grid[0]), abs=1e-6
    )


def test_skin_tones_darken_along_the_scale():
    brightness = [tone_color(t).mean() for t in np.linspace(0, 1, len(TONES))]
    assert (np.diff(brightness[2:]) < 0).all()
    assert brightness[0] > 3 * brightness[-1]
    texture = skin_texture(0.5, np.zeros(3), IRISES[0], np.random.default_rng(0))
    assert texture[256, 200] / 255 == pytest.approx(tone_color(0.5), abs=0.12)
