"""Rays from a table over the radius against the camera's own, for all its lens models."""

import numpy as np
import pytest

from egocap.cameras.rig_files import load_rig
from egocap_sim.core.resources import rig_file
from egocap_sim.render.pixel_rays import pixel_rays
from egocap_sim.scene.rig_sampler import sample_rig


@pytest.mark.parametrize("seed", [None, *range(400, 412)])
def test_rays_are_those_of_the_camera(seed):
    rig = load_rig(rig_file("egorig1")) if seed is None else sample_rig(np.random.default_rng(seed))
    camera = rig.resized(97, 81).cameras[0]
    pixels = np.stack(np.meshgrid(np.arange(97.0), np.arange(81.0)), -1)
    rays, theta = pixel_rays(camera)
    expected, _ = camera.ray(pixels)
    np.testing.assert_allclose(rays, expected, atol=2e-7)
    np.testing.assert_allclose(np.cos(theta), rays[..., 2], atol=1e-12)
    assert np.abs(np.linalg.norm(rays, axis=-1) - 1.0).max() < 1e-9
