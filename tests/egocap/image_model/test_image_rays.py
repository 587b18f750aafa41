"""Rays of images, their tiles and colours."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from egocap.cameras.rig import Rig
from egocap.cameras.rig_files import load_rig
from egocap.errors import InputError
from egocap.image_model.colour_measure import rgb_to_hsv
from egocap.image_model.image_rays import image_rays, ray_colours, ray_image, ray_numbers

RIG = load_rig(Path(__file__).parents[3] / "scenes/rigs/egorig1.toml")


def test_rays_project_back_to_their_pixels():
    small = RIG.resized(37, 29)  # no multiple of the tile
    rays = image_rays(small)
    for view in range(2):
        mine = rays.view == view
        where = rays.origins[view] + 1.3 * rays.direction[mine]
        pixels, valid = small.project(where)
        assert valid[view].all()
        np.testing.assert_allclose(pixels[view], rays.pixel[mine], atol=1e-9)
    assert len(np.unique(np.c_[rays.view, rays.pixel], axis=0)) == len(rays)


def test_tiles_hold_their_rays():
    rays = image_rays(RIG, 37, 29)
    angle = np.arccos(np.clip((rays.direction * rays.tile_axis[rays.tile]).sum(-1), -1, 1))
    assert (angle <= rays.tile_angle[rays.tile]).all()
    assert (rays.tile_view[rays.tile] == rays.view).all()
    assert (np.diff(rays.tile) >= 0).all()


def test_colours_are_those_of_the_pixels():
    images = np.random.default_rng(0).integers(0, 256, (2, 29, 37, 3), np.uint8)
    rays = image_rays(RIG, 37, 29)
    hsv = ray_colours(rays, images)
    expected = rgb_to_hsv(images[rays.view, rays.pixel[:, 1], rays.pixel[:, 0]])
    np.testing.assert_allclose(hsv, expected, atol=1e-5)
    plane = ray_image(rays, hsv)
    np.testing.assert_allclose(
        plane[1, 14, 18], hsv[(rays.view == 1) & (rays.pixel == (18, 14)).all(1)][0]
    )
    assert np.isnan(plane[0, 0, 0]).all()  # outside the lens


def test_larger_images_are_averaged():
    image = np.zeros((58, 74, 3), np.uint8)
    image[::2] = 200
    hsv = ray_colours(image_rays(RIG, 37, 29), [image, image])
    np.testing.assert_allclose(hsv[:, 2], 100 / 255, atol=1e-6)


def test_what_does_not_fit_is_refused():
    with pytest.raises(InputError, match="1 images"):
        ray_colours(image_rays(RIG, 16, 16), [np.zeros((16, 16, 3), np.uint8)])
    left, right = RIG.mounts
    uneven = Rig("uneven", (left, replace(right, camera=right.camera.resized(8, 8))))
    with pytest.raises(InputError, match="sizes"):
        image_rays(uneven)


def test_every_pixel_with_a_ray_has_its_number():
    rays = image_rays(RIG, 40, 32)
    numbers = ray_numbers(rays)
    found = numbers[rays.view, rays.pixel[:, 1], rays.pixel[:, 0]]
    np.testing.assert_array_equal(found, np.arange(len(rays)))
    assert (numbers >= 0).sum() == len(rays)
