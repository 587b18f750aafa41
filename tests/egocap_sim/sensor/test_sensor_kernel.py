"""The compiled loops against their readable forms."""

import numpy as np
import pytest

from egocap_sim.sensor.light import DECODING
from egocap_sim.sensor.sensor_kernel import (
    NOISE_SAMPLES,
    add_light,
    develop,
    encoding_table,
    noise_table,
)

from .oracles import add_subframe, encode, expose, noisy

RNG = np.random.default_rng(0)
LIGHT = RNG.random((40, 50, 3), dtype=np.float32) * 1.2
NOISE = noise_table()


def test_noise_is_normal_and_uncorrelated():
    assert len(NOISE) == NOISE_SAMPLES
    assert NOISE.mean() == pytest.approx(0, abs=0.005) and NOISE.std() == pytest.approx(1, rel=0.01)
    assert np.mean(NOISE[1:] * NOISE[:-1]) == pytest.approx(0, abs=0.005)


def test_light_adds_up_as_in_the_readable_form():
    ours, theirs = LIGHT.copy(), LIGHT.copy()
    subframe = RNG.integers(0, 256, LIGHT.shape, np.uint8)
    weight = RNG.random(40, dtype=np.float32)
    weight[::7] = 0
    add_light(ours, subframe, weight, DECODING)
    add_subframe(theirs, subframe, weight)
    assert np.abs(ours - theirs).max() < 1e-6


@pytest.mark.parametrize(("well", "read", "gamma"), [(None, 0.0, 1.0), (800.0, 0.01, 1.3)])
def test_pictures_develop_as_in_the_readable_form(well, read, gamma):
    fall_off = RNG.random((40, 50), dtype=np.float32)
    start = RNG.integers(0, NOISE_SAMPLES - 150, 40)
    runs = np.stack([NOISE[s : s + 150].reshape(50, 3) for s in start])
    ours = develop(LIGHT, 2**0.5, fall_off, 1 / well if well else 0.0, read**2, NOISE, start,
                   encoding_table(gamma))  # fmt: skip
    theirs = encode(noisy(expose(LIGHT, 0.5) * fall_off[..., None], well, read, runs), gamma)
    difference = np.abs(ours.astype(int) - theirs)
    assert difference.max() <= 1 and (difference > 0).mean() < 0.05
