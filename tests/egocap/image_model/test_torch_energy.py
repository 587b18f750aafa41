"""The readable colour energy: any measure, any device, many poses; what cannot be is refused."""

from pathlib import Path

import numpy as np
import pytest
import torch

from egocap.body.gaussians import GaussianBody
from egocap.body.proportions import Proportions
from egocap.cameras.rig_files import load_rig
from egocap.errors import InputError, MachineError
from egocap.image_model.colour_measure import PAPER, ColourMeasure
from egocap.image_model.image_rays import image_rays
from egocap.image_model.kernel_arrays import Palettes
from egocap.image_model.torch_energy import (
    RayBatch,
    colour_energy,
    colour_gradient,
    palette_batch,
    pixel_energy,
    torch_device,
)

RAYS = image_rays(load_rig(Path(__file__).parents[3] / "scenes/rigs/egorig1.toml"), 16, 16)
RNG = np.random.default_rng(0)
BODY = GaussianBody.from_proportions(Proportions.from_lengths(1.75)).with_colour(
    RNG.uniform(0.02, 0.98, (91, 3))
)
POSES = torch.tensor(0.1 * RNG.normal(size=(2, 37)))
HSV = RNG.uniform(size=(len(RAYS), 3))
PALETTES = Palettes(
    RNG.integers(0, 7, len(RAYS)).astype(np.int32), RNG.uniform(-1, 1, (91, 7)).astype(np.float32)
)


def test_a_palettes_energy_is_the_sum_over_bins_and_gaussians():
    batch, measure = palette_batch(RAYS, PALETTES)
    few = batch[torch.arange(0, len(RAYS), 40)]
    found = measure.compare(None, few.colours[..., None, :])
    expected = PALETTES.unlike[:, PALETTES.bins[::40]].T
    np.testing.assert_allclose(found, expected)
    assert found.shape == (len(few.origins), 91)
    energies = pixel_energy(BODY, few, POSES, measure)
    assert energies.shape == (2, len(few.origins)) and energies.abs().max() <= 1.0 + 1e-9


def test_the_gradient_in_chunks_is_autograd_of_the_whole():
    batch, measure = palette_batch(RAYS, PALETTES)
    batch = batch[torch.arange(0, len(RAYS), 5)]
    energy, gradient = colour_gradient(BODY, batch, POSES, measure, chunk=30)
    poses = POSES.clone().requires_grad_(True)
    whole = colour_energy(BODY, batch, poses, measure, chunk=1000)
    (expected,) = torch.autograd.grad(whole.sum(), poses)
    torch.testing.assert_close(energy, whole.detach())
    torch.testing.assert_close(gradient, expected)


@pytest.mark.parametrize("measure", [PAPER, ColourMeasure(), None])
def test_nothing_is_made_on_another_device_than_the_tensors(measure):
    """The meta device has shapes and no numbers: a tensor made on the CPU would not mix with it."""
    if measure is None:
        batch, measure = palette_batch(RAYS, PALETTES, torch.float32, "meta")
    else:
        batch = RayBatch.from_rays(RAYS, measure.features(HSV), torch.float32, "meta")
    poses = torch.zeros(3, 37, device="meta")
    energy, gradient = colour_gradient(BODY, batch, poses, measure)
    assert energy.shape == (3,) and gradient.shape == (3, 37)
    assert energy.device == gradient.device == batch.device == torch.device("meta")


def test_angles_elsewhere_than_the_rays_are_refused():
    batch, measure = palette_batch(RAYS, PALETTES, torch.float32, "meta")
    with pytest.raises(InputError, match="angles on cpu, rays on meta"):
        colour_gradient(BODY, batch, POSES, measure)
    with pytest.raises(InputError, match="one device"):
        pixel_energy(BODY, batch, POSES, measure)


def test_devices_by_name(monkeypatch):
    assert torch_device("cpu").type == "cpu"
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    assert torch_device("cuda:0").index == 0
    for name in ("tpu", "cuda:x", ""):
        with pytest.raises(InputError, match="no device"):
            torch_device(name)
    with pytest.raises(MachineError, match="finds 1 GPUs"):
        torch_device("cuda:1")
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 0)
    with pytest.raises(MachineError, match="with CUDA"):
        torch_device("cuda")
