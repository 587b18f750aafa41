"""Lens shapes against the cameras that the tracker uses, and their derivatives."""

import numpy as np
import pytest

from egocap.calibration.lens_shape import convert, lens_shapes
from egocap.errors import InputError

SIZE = (1280, 1024)
LENSES = {
    "equidistant": [640.0, 511.0, 405.0, 406.0],
    "kannala_brandt": [640.0, 511.0, 405.0, 406.0, 0.02, -0.008, 0.002, -0.0004],
    "ocam of degree 4": [640.0, 511.0, 0.999, 3e-4, -0.62, 0.35, -0.1, 0.09],
    "ocam of degree 5": [640.0, 511.0, 0.999, 3e-4, -0.62, 0.35, -0.1, 0.09, 0.01],
    "ocam of degree 6": [640.0, 511.0, 0.999, 3e-4, -0.62, 0.35, -0.1, 0.09, 0.01, 0.005],
}
SHAPES = {shape.title: shape for shape in lens_shapes(None, SIZE)}


def points():
    theta, azimuth = np.meshgrid(np.linspace(0.05, 1.6, 9), np.linspace(0.0, 6.0, 7))
    rays = [np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)]
    return 0.4 * np.stack(rays, -1).reshape(-1, 3)


@pytest.mark.parametrize("title", LENSES)
def test_projection_is_that_of_the_camera(title):
    shape, p = SHAPES[title], np.array(LENSES[title])
    pixels, _ = shape.camera(p, SIZE, 1.65).project(points())
    assert np.abs(shape.project(points(), p)[0] - pixels).max() < 2e-5


@pytest.mark.parametrize("title", LENSES)
def test_derivatives_are_those_of_differences(title):
    shape, p = SHAPES[title], np.array(LENSES[title])
    _, by_point, by_lens = shape.project(points(), p)
    for k in range(3):
        step = 1e-7 * np.eye(3)[k]
        ahead, behind = (shape.project(points() + s * step, p)[0] for s in (1, -1))
        assert np.allclose(by_point[:, :, k], (ahead - behind) / 2e-7, rtol=1e-5, atol=1e-3)
    for k in range(len(p)):
        step = 1e-6 * np.eye(len(p))[k]
        ahead, behind = (shape.project(points(), p + s * step)[0] for s in (1, -1))
        assert np.allclose(by_lens[:, :, k], (ahead - behind) / 2e-6, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("title", LENSES)
def test_conversion_from_an_equidistant_lens_keeps_its_radius(title):
    start = np.array(LENSES["equidistant"])
    p = convert(SHAPES["equidistant"], start, SHAPES[title], 1.5)
    apart = (
        SHAPES[title].project(points(), p)[0] - SHAPES["equidistant"].project(points(), start)[0]
    )
    inside = np.arctan2(np.hypot(*points().T[:2]), points()[:, 2]) < 1.5
    assert np.abs(apart[inside]).max() < 6.0


def test_unknown_model():
    with pytest.raises(InputError, match="kannala_brandt"):
        lens_shapes("pinhole", SIZE)
