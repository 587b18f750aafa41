"""Solving for poses on pictures that the model itself draws, and learning colours from them."""

from pathlib import Path

import numpy as np
import pytest

from egocap.body.gaussians import GaussianBody
from egocap.body.proportions import Proportions
from egocap.body.skeleton import DOF_INDEX, forward
from egocap.cameras.rig_files import load_rig
from egocap.errors import InputError
from egocap.image_model.colour_measure import hsv_to_rgb
from egocap.image_model.colour_solver import (
    UPPER_BODY,
    ImageSolver,
    ImageSolverConfig,
    track_colours,
)
from egocap.image_model.image_rays import image_rays, ray_image
from egocap.image_model.model import ImageModel
from egocap.image_model.palette import colour_body
from egocap.pose.inverse_kinematics import nearest_angles

RIG = load_rig(Path(__file__).parents[3] / "scenes/rigs/egorig1.toml")
RAYS = image_rays(RIG, 48, 48)
PERSON = Proportions.from_lengths(1.75)
POSE = np.zeros(37)
for _name, _degrees in {
    "left_shoulder_raise": 50, "right_shoulder_raise": 35, "left_elbow_flexion": 40,
    "right_elbow_flexion": 60, "left_hip_flexion": 30, "left_knee_flexion": 20,
}.items():  # fmt: skip
    POSE[DOF_INDEX[_name]] = np.deg2rad(_degrees)
SKIN, SHIRT, TROUSERS = (0.07, 0.6, 0.7), (0.6, 0.9, 0.8), (0.0, 0.9, 0.6)


def dressed():
    body = GaussianBody.from_proportions(PERSON)
    kinds = {"hand": SKIN, "forearm": SKIN, "head": SKIN, "neck": SKIN,
             "thigh": TROUSERS, "shank": TROUSERS, "foot": TROUSERS,
             "pelvis": TROUSERS}  # fmt: skip
    colours = [next((c for k, c in kinds.items() if p.endswith(k)), SHIRT) for p in body.parts]
    return body.with_colour(np.array(colours))


BODY = dressed()


def picture(angles):
    """What the model looks like before a grey-green floor, as 8-bit images."""
    seen = ImageModel(BODY, RAYS).visibility(angles)
    floor = np.array([0.35, 0.42, 0.35])
    rgb = seen @ hsv_to_rgb(BODY.colour) + (1 - seen.sum(1))[:, None] * floor
    return [(255 * np.clip(p, 0, 1)).astype(np.uint8) for p in ray_image(RAYS, rgb, 0.0)]


@pytest.fixture(scope="module")
def images():
    return picture(POSE)


@pytest.fixture(scope="module")
def solver():
    return ImageSolver(ImageModel(BODY, RAYS, threads=1), ImageSolverConfig(iterations=30))


def arm_errors(angles):
    """Distances of shoulders, elbows and wrists, metres."""
    wrong = np.linalg.norm(forward(PERSON, angles) - forward(PERSON, POSE), axis=-1)
    return wrong[[2, 3, 4, 6, 7, 8]]


def perturbed(degrees, seed=0):
    rng = np.random.default_rng(seed)
    return POSE + np.deg2rad(degrees) * rng.choice([-1.0, 1.0], 37) * UPPER_BODY


def test_arms_return_by_colour_alone(solver, images):
    start = perturbed(5.0)
    found = solver.solve(solver.model.colours(images), start)
    assert arm_errors(start).mean() > 0.06
    # The energy's own minimum lies 4 cm off: covering the rim's mixed colours still pays.
    assert arm_errors(found.angles).mean() < 0.05
    before, after = (
        solver.model.evaluate(a, solver.model.colours(images)).energy for a in (start, found.angles)
    )
    assert after < before


def test_angles_that_are_not_free_stay(images):
    model = ImageModel(BODY, RAYS, threads=1)
    solver = ImageSolver(model, ImageSolverConfig(iterations=5), free=UPPER_BODY)
    start = perturbed(5.0)
    for found in track_colours(solver, [model.colours(images)] * 2, start, 30.0):
        np.testing.assert_array_equal(found.angles[~UPPER_BODY], start[~UPPER_BODY])
        assert np.abs(found.angles - start)[UPPER_BODY].max() > 1e-3


def test_settings_out_of_range_are_refused():
    for name in ("iterations", "reference_rays"):
        with pytest.raises(InputError, match=name):
            ImageSolverConfig(**{name: 0})
    with pytest.raises(InputError, match="lambda_colour"):
        ImageSolverConfig(lambda_colour=-1.0)


def test_colours_are_read_off_the_image(images):
    found = colour_body(GaussianBody.from_proportions(PERSON), RAYS, images, POSE)
    shown = hsv_to_rgb(found.colour)
    worn = hsv_to_rgb(BODY.colour)
    large = [p.endswith(("chest", "upper_arm", "forearm", "head")) for p in BODY.parts]
    assert np.abs(shown - worn)[large].mean() < 0.08
    wrong = [p.endswith(("thigh", "pelvis")) for p in BODY.parts]
    assert np.median(np.abs(shown - worn)[wrong]) < 0.15


def test_nearest_angles_find_the_joints():
    joints = forward(PERSON, POSE)
    found = nearest_angles(PERSON, joints)
    assert np.abs(forward(PERSON, found) - joints).max() < 2e-3


def test_a_solution_carries_the_colours_of_its_own_pose(images, solver):
    """Or none, where the model was asked about another pose since."""
    colours = solver.model.colours(images)
    carried = 0
    for seed in range(4):
        found = solver.solve(colours, perturbed(6, seed))
        if found.colour is None:
            continue
        carried += 1
        again = solver.model.evaluate(found.angles, colours, curvature=True)
        assert found.colour.energy == pytest.approx(again.energy)
        np.testing.assert_allclose(found.colour.gradient, again.gradient, rtol=1e-5, atol=1e-6)
    assert carried
