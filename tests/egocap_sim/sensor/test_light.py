"""Each fault of the light against its known answer."""

import numpy as np
import pytest

from egocap.cameras.camera import Camera
from egocap_sim.sensor.light import compress, vignette

from .oracles import decode, encode, expose, noisy

LEVELS = np.arange(256, dtype=np.uint8).reshape(16, 16)[..., None].repeat(3, -1)


def test_encoding_undoes_decoding():
    assert np.array_equal(encode(decode(LEVELS)), LEVELS)
    assert np.array_equal(encode(decode(LEVELS), gamma=1.0), encode(decode(LEVELS)))


@pytest.mark.parametrize("gamma", [0.5, 2.0])
def test_gamma_is_a_power_of_the_displayed_value(gamma):
    expected = 255 * (LEVELS / 255.0) ** gamma
    found = encode(decode(LEVELS), gamma).astype(float)
    assert np.abs(found - expected)[LEVELS > 8].max() <= 1.0


def test_a_stop_doubles_the_light_and_white_clips():
    grey = np.full((4, 4, 3), 100, np.uint8)
    brighter = encode(expose(decode(grey), 1.0))
    assert np.all(np.abs(brighter - 100 * np.sqrt(2)) <= 0.5)
    assert np.all(encode(expose(decode(grey), 6.0)) == 255)


def test_vignetting_follows_the_angle_off_axis():
    """An equidistant lens: theta is the distance from the centre over the focal length."""
    camera = Camera("equidistant", 201, 201, (100.0, 100.0), ((100.0, 0.0), (0.0, 100.0)),
                    max_angle=1.0)  # fmt: skip
    share = vignette(camera, 0.4)
    assert share[100, 100] == pytest.approx(1.0)
    assert share[100, 150] == pytest.approx(1 - 0.4 * 0.25)
    assert share[0, 100] == pytest.approx(0.6)
    assert share[0, 0] == pytest.approx(0.6)  # beyond the lens nothing more is lost


@pytest.mark.parametrize("level", [0.05, 0.2, 0.8])
@pytest.mark.parametrize(("well", "read"), [(1000.0, 0.0), (None, 0.02), (500.0, 0.01)])
def test_noise_variance_is_that_of_shot_and_read_noise(level, well, read):
    light = np.full((200, 200, 3), level, np.float32)
    found = noisy(light, well, read, np.random.default_rng(0).standard_normal(light.shape))
    expected = (level / well if well else 0.0) + read**2
    assert found.mean() == pytest.approx(level, abs=4 * np.sqrt(expected / light.size))
    assert found.var() == pytest.approx(expected, rel=0.03)  # 6 standard errors


def test_jpeg_keeps_the_size_and_loses_more_at_lower_quality():
    rng = np.random.default_rng(1)
    image = np.clip(rng.normal(128, 30, (64, 80, 3)), 0, 255).astype(np.uint8)
    errors = [np.abs(compress(image, q).astype(int) - image).mean() for q in (95, 60, 10)]
    assert compress(image, 50).shape == image.shape
    assert errors == sorted(errors) and errors[0] > 0
