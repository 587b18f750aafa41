"""A person's colours against the background's: what tells them apart counts, and nothing else."""

from pathlib import Path

import numpy as np
import pytest

from egocap.body.gaussians import GaussianBody
from egocap.body.labels import LABELS
from egocap.body.proportions import Proportions
from egocap.body.skeleton import DOF_INDEX, DOFS, forward
from egocap.cameras.rig_files import load_rig
from egocap.errors import InputError
from egocap.image_model.colour_measure import hsv_to_rgb
from egocap.image_model.colour_solver import UPPER_BODY, ImageSolver, ImageSolverConfig
from egocap.image_model.colour_term import ColourTerm, ColourTermConfig, movable_angles
from egocap.image_model.image_rays import image_rays, ray_image
from egocap.image_model.kernel_arrays import Palettes
from egocap.image_model.model import ImageModel
from egocap.image_model.palette import BINS, Background, Palette, learn_palette

RIG = load_rig(Path(__file__).parents[3] / "scenes/rigs/egorig1.toml")
RAYS = image_rays(RIG, 40, 40)
PERSON = Proportions.from_lengths(1.75)
POSE = np.zeros(37)
for _name, _degrees in {
    "left_shoulder_raise": 50, "right_shoulder_raise": 35, "left_elbow_flexion": 40,
    "right_elbow_flexion": 60,
}.items():  # fmt: skip
    POSE[DOF_INDEX[_name]] = np.deg2rad(_degrees)
LABEL_INDEX = {name: i for i, name in enumerate(LABELS)}
BLUE, GREY = (0.6, 0.7, 0.6), (0.6, 0.02, 0.45)
BODY = GaussianBody.from_proportions(PERSON).with_colour(np.tile(BLUE, (91, 1)))


def picture(floor, angles=POSE, body=BODY):
    """The body before a floor of one colour, as 8-bit images."""
    seen = ImageModel(body, RAYS).visibility(angles)
    rgb = seen @ hsv_to_rgb(body.colour) + (1 - seen.sum(1))[:, None] * hsv_to_rgb(np.array(floor))
    return [(255 * np.clip(p, 0, 1)).astype(np.uint8) for p in ray_image(RAYS, rgb, 0.0)]


@pytest.fixture(scope="module")
def before_grey():
    return picture(GREY)


@pytest.fixture(scope="module")
def palette(before_grey):
    return learn_palette(BODY, RAYS, [(before_grey, POSE)])


def test_bins_part_colours_and_not_shades():
    hsv = np.array([[0.0, 0.9, 0.8], [0.33, 0.9, 0.8], [0.0, 0.02, 0.8], [0.0, 0.0, 0.0]])
    found = BINS.of(hsv)
    assert len(set(found)) == 4
    assert found.min() >= 0 and BINS.of(np.ones((1, 3)))[0] < BINS.count
    plane = 144
    shaded = BINS.of(hsv[:1] * [1, 1, 0.7])
    assert shaded[0] // plane != found[0] // plane and shaded[0] % plane == found[0] % plane


def test_own_colours_are_alike_and_others_are_not(palette):
    background = Background()
    bins = BINS.of(np.tile(GREY, (len(RAYS), 1)))
    background.update(bins, np.zeros(len(RAYS), np.float32))
    unlike = background.compare(palette, bins).unlike
    chest = BODY.parts.index("chest")
    assert unlike[chest, BINS.of(np.array([BLUE]))[0]] < -0.9
    assert unlike[chest, bins[0]] > 0.9
    assert np.abs(unlike[chest, BINS.of(np.array([[0.3, 0.9, 0.9]]))[0]]) < 0.7  # never seen


def test_a_background_like_the_body_tells_nothing(palette):
    background = Background()
    bins = BINS.of(np.tile(BLUE, (len(RAYS), 1)))
    background.update(bins, np.zeros(len(RAYS), np.float32))
    unlike = background.compare(palette, bins).unlike
    assert np.abs(unlike[BODY.parts.index("chest"), bins[0]]) < 0.25


def test_kernel_is_the_reference():
    torch = pytest.importorskip("torch")
    from egocap.image_model.torch_visibility import along_rays, cell_visibility, pose_gaussians

    rng = np.random.default_rng(0)
    rays = image_rays(RIG, 20, 20)
    colours = Palettes(
        rng.integers(0, 7, len(rays)).astype(np.int32),
        rng.uniform(-1, 1, (91, 7)).astype(np.float32),
    )
    model = ImageModel(BODY, rays, cutoff=1e-5)
    found = model.evaluate(POSE, colours, curvature=True)
    angles = torch.tensor(POSE, requires_grad=True)
    met = along_rays(
        pose_gaussians(BODY, angles), torch.tensor(BODY.sigma), torch.tensor(BODY.density),
        torch.tensor(rays.origins[rays.view]), torch.tensor(rays.direction),
    )  # fmt: skip
    seen = cell_visibility(met)
    energy = (torch.tensor(colours.unlike.T[colours.bins].astype(float)) * seen).sum()
    (gradient,) = torch.autograd.grad(energy, angles)
    assert found.energy == pytest.approx(energy.item(), abs=2e-3)
    np.testing.assert_allclose(found.gradient, gradient, atol=1e-3 * gradient.abs().max().item())
    np.testing.assert_allclose(model.opacity, seen.sum(-1).detach(), atol=1e-3)


def test_the_pose_is_held_by_colour_alone(palette, before_grey):
    """Where the paper's energy ends 4 cm off, as covering the rim's mixed colours pays."""
    model = ImageModel(BODY, RAYS, threads=1)
    term = ColourTerm(BODY, RIG, palette, ColourTermConfig(size=40), threads=1)
    start = POSE + np.deg2rad(5) * np.random.default_rng(0).choice([-1.0, 1.0], 37) * UPPER_BODY
    colours = term.set_images(before_grey, start)
    solver = ImageSolver(model, ImageSolverConfig(iterations=30), free=UPPER_BODY)
    found = solver.solve(colours, start)
    joints = [2, 3, 4, 6, 7, 8]
    wrong = np.linalg.norm(forward(PERSON, found.angles) - forward(PERSON, POSE), axis=-1)[joints]
    assert wrong.mean() < 0.03


def test_the_term_adds_its_derivatives(palette, before_grey):
    term = ColourTerm(BODY, RIG, palette, ColourTermConfig(size=40, weight=0.5), threads=1)
    term.set_images(before_grey, POSE)
    H, g = np.ones((37, 37)), np.ones(37)
    energy = term.add(POSE, H, g)
    assert energy < 0.0
    np.testing.assert_allclose(H, H.T)
    assert np.linalg.eigvalsh(H - 1.0).min() > -1e-6
    d, h = DOF_INDEX["left_shoulder_raise"], 1e-3
    ends = []
    for sign in (1, -1):
        moved = POSE.copy()
        moved[d] += sign * h
        ends.append(term.add(moved, np.zeros((37, 37)), np.zeros(37)))
    assert g[d] - 1.0 == pytest.approx((ends[0] - ends[1]) / (2 * h), rel=0.05, abs=0.5)


def test_hidden_limbs_are_left_alone(palette, before_grey):
    detected = np.ones(18, bool)
    detected[LABEL_INDEX["left_knee"] : LABEL_INDEX["left_foot"]] = False  # knee, ankle
    movable = movable_angles(detected)
    still = {n for n, f in zip(DOFS, movable, strict=True) if not f}
    assert {"left_hip_flexion", "left_knee_flexion"} <= still
    assert {"right_hip_flexion", "left_elbow_flexion", "left_wrist_flexion"} & still == set()
    term = ColourTerm(BODY, RIG, palette, ColourTermConfig(size=40), threads=1)
    term.set_images(before_grey, POSE)
    H, g = np.zeros((37, 37)), np.zeros(37)
    term.add(POSE, H, g, movable)
    assert not g[~movable].any() and not H[~movable].any() and not H[:, ~movable].any()
    assert g[movable].any()


def test_invalid_input_is_rejected(palette, before_grey):
    with pytest.raises(InputError, match="no frame shows"):
        Palette.learn(BODY, [np.zeros((5, 91), np.float32)], [np.zeros(5, np.int32)])
    term = ColourTerm(BODY, RIG, palette, ColourTermConfig(size=40))
    with pytest.raises(InputError, match="first frame"):
        term.set_images(before_grey)
    with pytest.raises(InputError, match="no images"):
        term.add(POSE, np.zeros((37, 37)), np.zeros(37))
    with pytest.raises(InputError, match="1 images"):
        term.set_images(before_grey[:1], POSE)
    with pytest.raises(InputError, match="pixels"):
        ColourTermConfig(size=4)
