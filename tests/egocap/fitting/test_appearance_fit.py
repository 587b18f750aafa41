"""Sizes of Gaussians found again in pictures that the model itself draws."""

from pathlib import Path

import numpy as np
import pytest

from egocap.body.gaussians import GaussianBody
from egocap.body.proportions import Proportions
from egocap.body.skeleton import DOF_INDEX
from egocap.cameras.rig_files import load_rig
from egocap.errors import InputError
from egocap.fitting.appearance_fit import fit_shape, resized
from egocap.image_model.colour_measure import hsv_to_rgb
from egocap.image_model.image_rays import image_rays, ray_image
from egocap.image_model.model import ImageModel

RIG = load_rig(Path(__file__).parents[3] / "scenes/rigs/egorig1.toml")
RAYS = image_rays(RIG, 64, 64)
PERSON = Proportions.from_lengths(1.75)
POSE = np.zeros(37)
for _name, _degrees in {
    "left_shoulder_raise": 60, "right_shoulder_raise": 50, "left_elbow_flexion": 30,
    "right_elbow_flexion": 60,
}.items():  # fmt: skip
    POSE[DOF_INDEX[_name]] = np.deg2rad(_degrees)


@pytest.fixture(scope="module")
def images():
    plain = GaussianBody.from_proportions(PERSON)
    thick = np.array([1.25 if part.endswith("forearm") else 1.0 for part in plain.parts])
    body = resized(plain, thick).with_colour(np.tile((0.6, 0.7, 0.6), (91, 1)))
    seen = ImageModel(body, RAYS).visibility(POSE)
    floor = hsv_to_rgb(np.array((0.1, 0.1, 0.5)))
    there = seen.sum(1) > 0.5  # people have sharp outlines
    rgb = np.where(there[:, None], hsv_to_rgb(body.colour[0]), floor)
    return [(255 * np.clip(p, 0, 1)).astype(np.uint8) for p in ray_image(RAYS, rgb, 0.0)]


def test_thick_forearms_are_found(images):
    found = fit_shape(PERSON, RIG, [(images, POSE)], size=64)
    # One frame against the prior: part of the way.
    assert found.scales["forearm"] > 1.04, found.scales
    assert found.scales["forearm"] > found.scales["upper_arm"] + 0.03, found.scales
    assert abs(found.scales["chest"] - 1.0) < 0.12
    arms = [part.endswith("forearm") for part in found.body.parts]
    assert np.abs(found.body.colour[arms, 0] - 0.6).max() < 0.1


def test_no_frame_is_refused():
    with pytest.raises(InputError, match="no frames"):
        fit_shape(PERSON, RIG, [])
