"""Faults of lens and colour processing against closed forms."""

import cv2
import numpy as np
import pytest

from egocap.cameras.camera import Camera
from egocap_sim.sensor.light import vignette
from egocap_sim.sensor.optics import aberrated, balance_gains, glare, saturated, toned
from egocap_sim.sensor.sensor_kernel import encoding_table

CAMERA = Camera("equidistant", 201, 201, (90.0, 110.0), ((100.0, 0.0), (0.0, 100.0)),
                max_angle=1.0)  # fmt: skip


def test_glare_keeps_the_sum_and_veils_the_dark():
    light = np.zeros((160, 200, 3), np.float32)
    light[70:90, 90:110] = 1.0
    veiled = glare(light, 0.2)
    assert veiled.sum() == pytest.approx(light.sum(), rel=0.02)
    assert veiled[80, 100, 0] < 0.9 and veiled[60, 100, 0] > veiled[40, 100, 0] > 0.0
    np.testing.assert_array_equal(glare(light, 0.0), light)


def test_aberration_scales_red_and_blue_about_the_principal_point():
    v, u = np.mgrid[:201, :201]
    dot = np.exp(-((u - 170) ** 2 + (v - 50) ** 2) / 8.0).astype(np.float32)
    made = aberrated(np.repeat(dot[..., None], 3, 2), CAMERA, 0.02)
    found = [np.array([(u * c).sum(), (v * c).sum()]) / c.sum() for c in np.moveaxis(made, -1, 0)]
    centre, off = np.array([90.0, 110.0]), np.array([80.0, -60.0])
    for place, scale in zip(found, (1.02, 1.0, 0.98), strict=True):
        np.testing.assert_allclose(place, centre + scale * off, atol=0.05)


def test_a_stop_of_warmth_is_the_ratio_of_red_to_blue():
    red, green, blue = balance_gains(1.0)
    assert red / blue == pytest.approx(2.0) and green == 1.0 and red * blue == pytest.approx(1.0)


def test_tone_curve_keeps_ends_and_middle_and_grows():
    values = np.linspace(0, 1, 101)
    for strength in (0.0, 0.5, 1.0):
        curve = toned(values, strength)
        np.testing.assert_allclose(curve[[0, 50, 100]], [0.0, 0.5, 1.0], atol=1e-12)
        assert (np.diff(curve) >= 0).all()
    assert toned(np.array(0.25), 1.0) < 0.25 < 0.75 < toned(np.array(0.75), 1.0)
    assert (encoding_table(1.0, 1.0)[[0, -1]] == [0, 255]).all()


def test_no_saturation_is_the_grey_of_opencv():
    image = np.random.default_rng(0).integers(0, 256, (20, 30, 3), np.uint8)
    grey = saturated(image, 0.0).astype(int)
    expected = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(int)
    assert np.abs(grey - expected[..., None]).max() <= 1
    assert np.array_equal(saturated(image, 1.0), image)


def test_light_fades_to_black_over_the_rim():
    share = vignette(CAMERA, 0.0, rim=0.2)
    assert share[110, 90] == 1.0 and share[110, 165] == 1.0  # 0.75 of the field of view
    assert share[110, 180] == pytest.approx(0.5)  # 0.9
    assert share[110, 190] == pytest.approx(0.0, abs=1e-6)
