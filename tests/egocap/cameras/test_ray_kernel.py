"""The compiled rays against the camera's own methods."""

import numpy as np
import pytest

from egocap.cameras.ray_kernel import cast, make_lens
from tests.egocap.cameras.test_camera import CAMERAS, made


@pytest.mark.parametrize("name", CAMERAS)
def test_rays_and_derivatives(name):
    camera = made(name)
    pixels = np.random.default_rng(0).uniform(-400.0, 1700.0, (30, 20, 2))
    pixels[0, 0] = camera.centre
    rays, J, seen = cast(make_lens(camera), pixels)
    expected, valid = camera.ray(pixels)
    np.testing.assert_allclose(rays, expected, atol=1e-14)
    np.testing.assert_allclose(J, camera.project_jacobian(expected)[1], atol=1e-10)
    np.testing.assert_array_equal(seen, valid)
    assert 0.1 < seen.mean() < 0.9
