"""Corners of rendered saddles: each pixel the mean of many points, light, tone and noise added."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from egocap.calibration.saddle_fit import Surroundings, fit_saddles

HALF, FINE, BLUR = 10, 9, 0.7  # pixels; points a pixel; pixels
PX_PER_UNIT = 8.0


def picture(corner, turn, slope=0.0, gamma=1.0):
    """Grey values (21, 21) of two edges that cross at `corner` [px], turned by `turn` [rad]."""
    side = 2 * HALF + 1 + 8  # rim for the blur
    at = (np.arange(side * FINE) + 0.5) / FINE - side / 2
    x, y = np.meshgrid(at - corner[0], at - corner[1])
    u, v = np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x
    edges = np.clip(2 * FINE * u, -1, 1) * np.clip(2 * FINE * v, -1, 1)
    light = (0.43 + 0.38 * edges) * (1.0 + slope * (x + 0.3 * y))
    light = gaussian_filter(light, BLUR * FINE)
    mean = light.reshape(side, FINE, side, FINE).mean((1, 3))[4:-4, 4:-4]
    return 255.0 * mean**gamma


def surroundings(images, turn):
    """Edges along x and y of a board that is turned in the image."""
    side = np.arange(-HALF, HALF + 1)
    x, y = np.meshgrid(side, side)
    u = np.stack([np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x], -1)
    u = np.broadcast_to(u.reshape(1, -1, 2) / PX_PER_UNIT, (len(images), x.size, 2))
    weight = np.where((np.abs(u) < 1).all(-1), np.exp(-2 * (u**2).sum(-1)), 0.0)
    grey = np.array(images).reshape(len(images), -1)
    return Surroundings(grey, u, weight, np.full((len(images), 2), 1 / PX_PER_UNIT))


def found(images, turn):
    """Corners [px] along the board's axes, and their covariance [px^2]."""
    corner, covariance = fit_saddles(surroundings(images, turn), np.full((len(images), 2), 0.03))
    return PX_PER_UNIT * corner, PX_PER_UNIT**2 * covariance


@pytest.mark.parametrize("turn", [0.0, 0.4])
@pytest.mark.parametrize(("slope", "gamma"), [(0.0, 1.0), (0.006, 1.0), (0.006, 0.5)])
def test_uneven_light_and_tone_do_not_move_corners(turn, slope, gamma):
    corners = np.array([[0.0, 0.0], [0.4, -0.3], [-0.21, 0.47]])
    own = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    at, _ = found([picture(c, turn, slope, gamma) for c in corners], turn)
    assert np.abs(at - corners @ own.T).max() < 0.005


def test_stated_covariance_is_that_of_noise():
    rng, clean = np.random.default_rng(5), picture((0.1, 0.2), 0.3)
    at, covariance = found([clean + 4.0 * rng.standard_normal(clean.shape) for _ in range(300)],
                           0.3)  # fmt: skip
    spread = np.cov((at - at.mean(0)).T)
    stated = covariance.mean(0)
    assert np.sqrt(np.trace(spread) / np.trace(stated)) == pytest.approx(1.0, abs=0.12)
    assert np.sqrt(np.trace(spread) / 2) < 0.05


def test_unused_pixels_do_not_matter():
    image = picture((0.2, -0.1), 0.0)
    dirty = image.copy()
    dirty[:2] = 0.0  # beyond the patch
    assert np.array_equal(found([image], 0.0)[0], found([dirty], 0.0)[0])
