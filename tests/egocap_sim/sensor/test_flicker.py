"""Lamps on the mains: brightness over an exposure, over frames, and over a picture's rows."""

import numpy as np
import pytest

from egocap_sim.sensor.config import SensorTable
from egocap_sim.sensor.light import lamp_light, lamp_rows


def test_the_mean_over_an_exposure_is_that_of_brute_force():
    sensor = SensorTable(flicker=0.4, mains_hz=60, shutter_s=0.0031)
    t = 0.017 + np.linspace(-0.5, 0.5, 20001) * sensor.shutter_s
    wave = 1.0 + 0.4 * np.cos(2 * np.pi * 120.0 * t + 0.7)
    assert lamp_light(np.array(0.017), sensor, 0.7) == pytest.approx(wave.mean(), abs=1e-5)


@pytest.mark.parametrize(
    ("mains", "shutter"), [(50, 0.01), (50, 0.02), (60, 1 / 120), (60, 1 / 60)]
)
def test_whole_half_periods_show_no_flicker(mains, shutter):
    sensor = SensorTable(flicker=0.5, mains_hz=mains, shutter_s=shutter)
    np.testing.assert_allclose(lamp_light(np.linspace(0, 1, 50), sensor, 1.0), 1.0, atol=1e-9)


def test_frames_beat_with_the_mains():
    """100 Hz seen 30 times a second comes back every third frame, at 10 Hz."""
    sensor = SensorTable(flicker=0.5, mains_hz=50, shutter_s=1e-3)
    seen = lamp_light(np.arange(30) / 30, sensor, 0.3)
    assert np.ptp(seen) > 0.5
    np.testing.assert_allclose(seen[3:], seen[:-3], atol=1e-9)
    # 120 Hz is a multiple of the frame rate: all frames alike.
    assert (
        np.ptp(lamp_light(np.arange(30) / 30, sensor.model_copy(update={"mains_hz": 60}), 0.3))
        < 1e-9
    )


def test_a_rolling_shutter_shows_bands_and_a_global_one_none():
    rolling = SensorTable(flicker=0.5, shutter_s=1e-3, readout_s=0.02)
    rows = lamp_rows(0.1, 512, rolling, 0.0)
    power = np.abs(np.fft.rfft(rows - rows.mean()))
    assert power.argmax() == 2  # 0.02 s of 100 Hz
    still = lamp_rows(0.1, 512, SensorTable(flicker=0.5, shutter_s=1e-3), 0.0)
    assert np.ptp(still) == 0.0
    assert np.ptp(lamp_rows(0.1, 512, SensorTable(shutter_s=1e-3, readout_s=0.02), 0.0)) == 0.0


def test_off_by_default_and_in_the_mild_presets():
    for preset in ("clean", "webcam", "action-camera"):
        assert SensorTable.model_validate({"preset": preset}).flicker == 0.0
    assert not SensorTable(mains_hz=60).active and SensorTable(flicker=0.1).active
