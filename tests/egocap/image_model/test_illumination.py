"""Light that changes slowly is followed on the person, whatever the background does."""

import numpy as np
import pytest

from egocap.image_model.colour_term import ColourTerm, ColourTermConfig
from egocap.image_model.illumination import Illumination, learn_in_light
from egocap.image_model.image_rays import ray_colours
from tests.egocap.image_model.test_palette import BODY, POSE, RAYS, RIG, picture

SHADES = np.random.default_rng(0).uniform(-0.1, 0.1, (91, 3)) * [0.3, 1.0, 1.0]
DRESSED = BODY.with_colour(np.clip(BODY.colour + SHADES, 0.0, 1.0))
DUSK = np.array([0.75, 0.6, 0.5])  # darker and warmer


@pytest.fixture(scope="module")
def noon():
    return picture((0.3, 0.3, 0.5), body=DRESSED)


def lit(images, gain):
    return [np.clip(image * gain, 0, 255).astype(np.uint8) for image in images]


@pytest.fixture
def light(noon):
    found = Illumination(DRESSED, RIG, RAYS)
    found.learn(ray_colours(RAYS, noon), POSE)
    return found


def test_a_frame_in_other_light_tells_it_at_once(light, noon):
    assert light.initialise(ray_colours(RAYS, lit(noon, DUSK)), POSE) > 20
    np.testing.assert_allclose(light.gain, DUSK, rtol=0.04)


def test_a_slow_ramp_is_followed(light, noon):
    for share in np.linspace(0.0, 1.0, 150):
        now = DUSK**share
        light.update(ray_colours(RAYS, lit(noon, now), light.gain), POSE)
        np.testing.assert_allclose(light.gain, now, rtol=0.1)
    assert np.abs(np.log(light.gain)).max() > 0.5


def test_a_pose_that_is_off_in_an_arm_does_not_mislead(light, noon):
    wrong = POSE.copy()
    wrong[9:17] += 0.5
    light.initialise(ray_colours(RAYS, noon), wrong)
    np.testing.assert_allclose(light.gain, 1.0, rtol=0.06)


def test_darkness_and_empty_views_change_nothing(light):
    for value in (0, 255):
        blank = [np.full((40, 40, 3), value, np.uint8)] * 2
        light.initialise(ray_colours(RAYS, blank), POSE)
        np.testing.assert_array_equal(light.gain, 1.0)


def test_colours_of_frames_in_two_lights_are_brought_to_one(noon):
    _, light = learn_in_light(DRESSED, RIG, RAYS, [(noon, POSE), (lit(noon, DUSK), POSE)])
    np.testing.assert_array_equal(light.gain, 1.0)
    light.initialise(ray_colours(RAYS, lit(noon, DUSK)), POSE)
    np.testing.assert_allclose(light.gain, DUSK, rtol=0.04)


def test_the_energy_of_the_right_pose_holds_while_the_light_fades(noon):
    palette, light = learn_in_light(DRESSED, RIG, RAYS, [(noon, POSE)])
    settings = ColourTermConfig(size=40)
    fixed = ColourTerm(DRESSED, RIG, palette, settings, threads=1)
    following = ColourTerm(DRESSED, RIG, palette, settings, threads=1, light=light)
    dusk, energies = DUSK**1.5, {}
    for name, term in (("fixed", fixed), ("following", following)):
        for share in np.linspace(0.0, 1.0, 90):
            term.set_images(lit(noon, dusk**share), POSE)
            if share in (0.0, 1.0):
                energy = term.add(POSE, np.zeros((37, 37)), np.zeros(37))
                energies.setdefault(name, []).append(energy)
            term.update_illumination(POSE)
    first, last = energies["following"]
    assert first < 0.0 and last < 0.8 * first
    assert last < energies["fixed"][-1] - 0.05 * abs(first)


def test_gain_divides_colours(noon):
    plain = ray_colours(RAYS, noon)
    halved = ray_colours(RAYS, noon, np.full(3, 2.0))
    np.testing.assert_allclose(halved[:, 2], plain[:, 2] / 2, atol=1e-6)
    np.testing.assert_allclose(halved[:, :2], plain[:, :2], atol=1e-5)
