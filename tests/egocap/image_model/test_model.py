"""The compiled image model against the readable one, in float64, and its statistics."""

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.special import erf

from egocap.body.gaussians import GaussianBody
from egocap.body.proportions import Proportions
from egocap.body.skeleton import LIMITS, SPREAD
from egocap.cameras.rig_files import load_rig
from egocap.errors import InputError
from egocap.image_model.colour_measure import PAPER, ColourMeasure
from egocap.image_model.image_rays import image_rays
from egocap.image_model.kernel_arrays import MAX_EDGES, Palettes
from egocap.image_model.model import ImageModel
from egocap.image_model.ray_kernel import ERF_ERROR, edge_values
from egocap.image_model.stochastic import PixelSampler, gradient_scatter, systematic
from egocap.image_model.torch_energy import (
    RayBatch,
    ReferenceModel,
    colour_energy,
    colour_gradient,
    pixel_energy,
)
from egocap.image_model.torch_visibility import along_rays, cell_visibility, pose_gaussians

RIG = load_rig(Path(__file__).parents[3] / "scenes/rigs/egorig1.toml")
RAYS = image_rays(RIG, 20, 20)
RNG = np.random.default_rng(0)
PLAIN = GaussianBody.from_proportions(Proportions.from_lengths(1.75))
BODY = PLAIN.with_colour(RNG.uniform(0.02, 0.98, (91, 3)))
POSE = np.clip(0.5 * SPREAD * RNG.normal(size=37), LIMITS[:, 0], LIMITS[:, 1])
HSV = RNG.uniform(size=(len(RAYS), 3))
PALETTES = Palettes(
    RNG.integers(0, 7, len(RAYS)).astype(np.int32), RNG.uniform(-1, 1, (91, 7)).astype(np.float32)
)
MEASURES = [PAPER, ColourMeasure("paper", 0.3), ColourMeasure()]


def prepared(measure=MEASURES[2], **settings):
    model = ImageModel(BODY, RAYS, measure=measure, **settings)
    colours = np.ascontiguousarray(measure.features(HSV), np.float32)
    return model, colours, RayBatch.from_rays(RAYS, colours.astype(float))


def hit_rays(model, colours, count):
    """Some rays that the body turns most."""
    _, pulls = model.pixel_energies(POSE, colours)
    return np.sort(np.argsort(pulls)[-4 * count :: 4]).astype(np.int32)


def test_error_function_is_within_its_bound():
    lanes = np.arange(MAX_EDGES, dtype=np.float32)
    out, bell = np.zeros((2, MAX_EDGES), np.float32), np.zeros((2, MAX_EDGES), np.float32)
    for start in np.linspace(-6, 6, 40, dtype=np.float32):
        edge_values(start, np.float32(0.11), 64, lanes, np.uint64(1), out, bell)
        x = start + lanes * np.float32(0.11)
        assert np.abs(out[1] - erf(x)).max() < ERF_ERROR
        assert np.abs(bell[1] - np.exp(-(x.astype(float) ** 2))).max() < 1.5e-6


def test_visibility_is_the_reference():
    model, _, batch = prepared(cutoff=1e-5)
    sigma, density = (torch.as_tensor(np.array(x)) for x in (BODY.sigma, BODY.density))
    met = along_rays(pose_gaussians(BODY, torch.tensor(POSE)), sigma, density,
                     batch.origins, batch.directions)  # fmt: skip
    seen = model.visibility(POSE)
    np.testing.assert_allclose(seen, cell_visibility(met), atol=2e-4)
    model.pixel_energies(POSE, np.zeros_like(HSV, np.float32))
    np.testing.assert_allclose(seen.sum(1), model.opacity, atol=1e-5)


@pytest.mark.parametrize("measure", MEASURES)
def test_kernel_is_the_reference(measure):
    model, colours, batch = prepared(measure, cutoff=1e-5)
    found = model.evaluate(POSE, colours)
    energy, gradient = colour_gradient(BODY, batch, torch.tensor(POSE), measure)
    assert found.energy == pytest.approx(energy.item(), abs=2e-3)
    scale = gradient.abs().max().item()
    np.testing.assert_allclose(found.gradient, gradient, atol=1e-3 * scale)
    pixels, _ = model.pixel_energies(POSE, colours)
    expected = pixel_energy(BODY, batch, torch.tensor(POSE), measure)
    np.testing.assert_allclose(pixels, expected, atol=1e-4)


def test_the_usual_cutoff_costs_little():
    model, colours, batch = prepared()
    found = model.evaluate(POSE, colours)
    energy, gradient = colour_gradient(BODY, batch, torch.tensor(POSE), model.measure)
    assert found.energy == pytest.approx(energy.item(), abs=1.0)  # of 600 pixels
    assert np.abs(found.gradient - gradient.numpy()).max() < 0.03 * gradient.abs().max()


def test_reference_gradient_is_that_of_central_differences():
    model, colours, batch = prepared()
    hit = torch.as_tensor(hit_rays(model, colours, 12))
    batch, angles = batch[hit], torch.tensor(POSE)
    _, gradient = colour_gradient(BODY, batch, angles, MEASURES[2])
    h = 1e-5
    shifted = angles + h * torch.cat([torch.eye(37), -torch.eye(37)]).double()
    ends = colour_energy(BODY, batch, shifted, MEASURES[2], chunk=4)
    central = (ends[:37] - ends[37:]) / (2 * h)
    torch.testing.assert_close(gradient, central, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("binned", [False, True])
def test_kernel_and_reference_are_called_alike(binned):
    """All of it by one signature: energy, gradient and Gauss-Newton matrix."""
    rays = image_rays(RIG, 10, 10)
    model, slow = ImageModel(BODY, rays, cutoff=1e-5), ReferenceModel(BODY, rays)
    colours = np.ascontiguousarray(model.measure.features(HSV[: len(rays)]), np.float32)
    if binned:
        colours = Palettes(PALETTES.bins[: len(rays)], PALETTES.unlike)
    found = model.evaluate(POSE, colours, curvature=True)
    expected = slow.evaluate(POSE, colours, curvature=True)
    assert found.energy == pytest.approx(expected.energy, abs=2e-3)
    for ours, theirs in (
        (found.gradient, expected.gradient),
        (found.curvature, expected.curvature),
    ):
        assert ours is not None and theirs is not None
        np.testing.assert_allclose(ours, theirs, atol=2e-3 * np.abs(theirs).max())


def test_selected_rays_count_by_their_weights():
    model, colours, batch = prepared(cutoff=1e-5)
    picked = hit_rays(model, colours, 12)
    found = model.evaluate(POSE, colours, selected=picked, weights=np.full(12, 2.0, np.float32))
    some = batch[torch.as_tensor(picked)]
    energy, gradient = colour_gradient(BODY, some, torch.tensor(POSE), model.measure)
    assert found.energy == pytest.approx(2.0 * energy.item(), abs=1e-3)
    scale = gradient.abs().max().item()
    np.testing.assert_allclose(found.gradient, 2.0 * gradient, atol=2e-3 * scale)


def test_many_poses_at_once_are_single_poses():
    _, _, batch = prepared()
    poses = torch.tensor(np.stack([POSE, 0.5 * POSE, 0.0 * POSE]))
    together, slopes = colour_gradient(BODY, batch[torch.arange(0, 400, 5)], poses)
    for i, pose in enumerate(poses):
        alone, slope = colour_gradient(BODY, batch[torch.arange(0, 400, 5)], pose)
        torch.testing.assert_close(together[i], alone)
        torch.testing.assert_close(slopes[i], slope)


def test_results_repeat_whatever_the_threads():
    model, colours, _ = prepared()
    alone, _, _ = prepared(threads=1)
    first, second = (m.evaluate(POSE, colours, curvature=True) for m in (model, alone))
    assert first.energy == pytest.approx(second.energy, abs=1e-9)
    np.testing.assert_allclose(first.gradient, second.gradient, atol=1e-9)
    np.testing.assert_allclose(first.curvature, second.curvature, atol=1e-9)


@pytest.mark.parametrize("binned", [False, True])
def test_random_pixels_and_gaussians_are_right_on_average(binned):
    model, colours, _ = prepared(threads=1)
    if binned:
        colours = PALETTES
    sampler, rng = PixelSampler(model), np.random.default_rng(1)
    sampler.aim(colours, POSE)
    exact = model.evaluate(POSE, colours)
    draws = [sampler.estimate(colours, POSE, 60, 0.5, rng) for _ in range(600)]
    gradients = np.array([d.gradient for d in draws])
    error = gradients.mean(0) - exact.gradient
    scatter = gradients.std(0) / np.sqrt(len(draws))
    assert np.abs(error / np.maximum(scatter, 1e-9))[scatter > 1e-6].max() < 4.5
    energies = np.array([d.energy for d in draws])
    assert abs(energies.mean() - exact.energy) < 4 * energies.std() / np.sqrt(len(draws))


def test_aiming_at_the_outline_lessens_the_scatter():
    model, _, _ = prepared(threads=1)
    aimed, evenly, rng = PixelSampler(model), PixelSampler(model), np.random.default_rng(0)
    aimed.aim(PALETTES, POSE)
    scatter, even = (
        gradient_scatter(s, PALETTES, POSE, 80, 1.0, 200, rng) for s in (aimed, evenly)
    )
    assert scatter < 0.5 * even
    assert gradient_scatter(aimed, PALETTES, POSE, 320, 1.0, 200, rng) < 0.6 * scatter


def test_the_same_seed_drops_the_same_gaussians():
    model, colours, _ = prepared()
    one, two, other = (model.evaluate(POSE, colours, keep=0.3, seed=s) for s in (5, 5, 6))
    np.testing.assert_array_equal(one.gradient, two.gradient)
    assert np.abs(one.gradient - other.gradient).max() > 1e-3


def test_systematic_picks_have_their_probabilities():
    importance = np.array([5.0, 0.5, 1.0, 0.2, 3.3])
    rng = np.random.default_rng(0)
    counts, mass = np.zeros(5), np.zeros(5)
    for _ in range(4000):
        picked, weights = systematic(importance, 3, rng.random())
        assert len(np.unique(picked)) == len(picked)
        counts[picked] += 1
        mass[picked] += weights
    np.testing.assert_allclose(counts / 4000, np.minimum(1, 3 * importance / 10), atol=0.03)
    np.testing.assert_allclose(mass / 4000, 1.0, atol=0.1)


def test_a_camera_inside_the_body_still_gives_finite_numbers():
    fat = GaussianBody.from_proportions(Proportions.from_lengths(1.75), girth=1.6)
    offset = fat.offset + np.array([0.35, 0.17, 0.4])  # the trunk around the left camera
    near = GaussianBody(
        fat.proportions, fat.parts, fat.joint, offset, fat.sigma, fat.density, BODY.colour
    )
    model = ImageModel(near, RAYS, cell=0.02, cutoff=1e-5)
    colours = np.ascontiguousarray(model.measure.features(HSV), np.float32)
    found = model.evaluate(POSE, colours, curvature=True)
    batch = RayBatch.from_rays(RAYS, colours.astype(float))
    energy, gradient = colour_gradient(near, batch, torch.tensor(POSE), model.measure)
    assert found.energy == pytest.approx(energy.item(), abs=0.05)
    scale = gradient.abs().max().item()
    np.testing.assert_allclose(found.gradient, gradient, atol=5e-3 * scale)


@pytest.mark.parametrize(
    "settings", [{"cell": 0.0}, {"cell": 0.001}, {"far": 1e9}, {"cutoff": 0.0}, {"threads": 99}]
)
def test_impossible_settings_are_refused(settings):
    with pytest.raises(InputError):
        ImageModel(BODY, RAYS, **settings)
