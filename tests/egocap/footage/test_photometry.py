"""Gains between views from colours of the same surroundings."""

import numpy as np
import pytest

from egocap.cameras.rig_files import load_rig
from egocap.footage.photometry import estimate_colour, median_colour, shared_surroundings

GAIN = np.array([1.2, 0.9, 0.75])


def seen(seed=0, n=90):
    rng = np.random.default_rng(seed)
    return np.arange(n) / 30.0, 90.0 + 40.0 * np.sin(np.arange(n)[:, None] / 9.0 + rng.random(3))


def test_gain_brings_a_view_to_the_first():
    time, colour = seen()
    found = estimate_colour(time, colour, time + 0.011, colour / GAIN)
    assert found.origin == "estimated"
    assert found.gain == pytest.approx(GAIN, rel=0.01)


def test_dark_saturated_and_unknown_pictures_are_left_out():
    time, colour = seen()
    other = colour / GAIN
    other[::3] = np.nan
    other[1::9] = 255.0
    other[2::9] = 3.0
    assert estimate_colour(time, colour, time, other).gain == pytest.approx(GAIN, rel=0.01)
    other[:] = np.nan
    assert estimate_colour(time, colour, time, other).origin == "assumed"
    assert estimate_colour(time, colour, time + 60.0, colour).gain == (1.0, 1.0, 1.0)


def test_views_share_the_surroundings_but_not_the_wearer(request):
    rig = load_rig(request.config.rootpath / "scenes/rigs/egorig1.toml")
    masks = shared_surroundings(rig)
    assert all(0.1 < mask.mean() < 0.7 for mask in masks)
    picture = np.zeros((64, 80, 3), np.uint8)
    picture[masks[0]] = (10, 20, 30)
    np.testing.assert_array_equal(median_colour(picture, masks[0]), [10, 20, 30])
    assert np.isnan(median_colour(picture, np.zeros((64, 80), bool))).all()
