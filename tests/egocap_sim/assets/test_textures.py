"""Textures: band and variance of the noise; seamless blades of grass."""

import numpy as np
import pytest

from egocap_sim.assets.textures import SIZE, grain, grass, noise


@pytest.mark.parametrize(("low", "high", "steep"), [(1, 6, 1.0), (20, 120, 0.3), (60, 250, 0.0)])
def test_noise_has_waves_in_its_band_only(low, high, steep):
    field = noise(np.random.default_rng(0), low, high, steep)
    assert field.mean() == pytest.approx(0.0, abs=1e-5)
    assert field.std() == pytest.approx(1.0, abs=1e-5)
    k = np.fft.fftfreq(SIZE, 1 / SIZE)
    waves, power = np.hypot(k[:, None], k), np.abs(np.fft.fft2(field)) ** 2
    assert power[(waves < low) | (waves > high)].sum() < 1e-6 * power.sum()


def test_noise_is_as_strong_along_the_axes_as_elsewhere():
    """Of white noise through the filter, every wave of one length has the same expected power."""
    fields = [noise(np.random.default_rng(s), 10, 10.9, 0.0) for s in range(300)]
    power = np.mean([np.abs(np.fft.fft2(f)) ** 2 for f in fields], axis=0)
    around = [power[0, 10], power[10, 0], power[6, 8], power[8, 6], power[-6, 8], power[-8, 6]]
    np.testing.assert_allclose(around, np.mean(around), rtol=0.25)


def test_grain_is_drawn_out_along_the_rows():
    field = grain(np.random.default_rng(0), 12)
    along, across = (np.square(np.diff(field, axis=a)).mean() for a in (1, 0))
    assert along < 0.05 * across


@pytest.mark.parametrize("axis", [0, 1])
def test_blades_of_grass_go_on_across_the_edge(axis):
    lawn = grass(np.random.default_rng(0)).texture.astype(float).mean(2)
    steps = np.abs(lawn - np.roll(lawn, 1, axis)).mean(1 - axis)
    assert steps[0] == pytest.approx(np.median(steps), rel=0.15)  # the first is that over the edge
    unlike = np.abs(lawn.take(0, axis) - lawn.take(SIZE // 2, axis)).mean()
    assert steps[0] < 0.8 * unlike
