"""Equation 4 against brute force, in closed cases, and its derivatives."""

import numpy as np
import pytest
import torch

from egocap.image_model.torch_visibility import (
    RayGaussians,
    absorbed_per_depth,
    along_rays,
    cell_visibility,
    optical_depth,
    sampled_visibility,
)

F64 = torch.float64
RNG = np.random.default_rng(1)


def rays_of(middle, depth, sigma):
    return RayGaussians(*(torch.as_tensor(np.asarray(a, float)) for a in (middle, depth, sigma)))


def brute(met, far=4.0, step=1e-4):
    """Both integrals by trapezoids of the densities: no error function."""
    s = np.arange(0.0, far, step)
    m, depth, sigma = (a.numpy() for a in met)
    rows = []
    for p in range(len(m)):
        x = (s[:, None] - m[p]) / sigma
        density = depth[p] / (sigma * np.sqrt(2 * np.pi)) * np.exp(-0.5 * x * x)
        total = density.sum(1)
        passed = np.exp(-np.concatenate([[0], np.cumsum((total[1:] + total[:-1]) / 2 * step)]))
        rows.append(np.trapezoid(passed[:, None] * density, dx=step, axis=0))
    return np.array(rows)


CASES = {
    "apart": rays_of(
        RNG.uniform(0.4, 2, (12, 5)), RNG.uniform(0.1, 4, (12, 5)), [0.03, 0.05, 0.04, 0.06, 0.02]
    ),
    "coincident": rays_of(np.full((4, 3), 0.7), RNG.uniform(0.5, 3, (4, 3)), [0.04, 0.04, 0.04]),
    "camera inside": rays_of(
        RNG.uniform(-0.08, 0.08, (8, 3)), RNG.uniform(0.5, 3, (8, 3)), [0.04] * 3
    ),
    "behind": rays_of([[-0.5, -1.0]], [[3.0, 3.0]], [0.05, 0.05]),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_cells_meet_brute_force_with_an_error_of_second_order(name):
    truth = brute(CASES[name])
    coarse, fine = (
        np.abs(cell_visibility(CASES[name], c, 4.0).numpy() - truth).max() for c in (0.02, 0.005)
    )
    assert coarse < 0.06
    assert fine < max(coarse / 8.0, 1e-6)


@pytest.mark.parametrize("name", ["apart", "coincident"])
def test_samples_meet_brute_force(name):
    truth = brute(CASES[name])
    assert np.abs(sampled_visibility(CASES[name], 41, 5.0).numpy() - truth).max() < 1e-4
    assert np.abs(sampled_visibility(CASES[name], samples=5).numpy() - truth).max() < 0.25


def test_cells_conserve_light_and_are_never_negative():
    for met in CASES.values():
        seen = cell_visibility(met, 0.03, 6.0)
        end = optical_depth(met, met.middle.new_full((len(met.middle), 1), 6.0))[:, 0].sum(-1)
        torch.testing.assert_close(seen.sum(-1), -torch.expm1(-end))
        assert (seen >= 0).all()


def test_one_gaussian_absorbs_by_its_optical_depth():
    met = rays_of([[1.0]], [[1.7]], [0.05])
    assert cell_visibility(met).item() == pytest.approx(1 - np.exp(-1.7), abs=1e-9)


def test_the_nearer_of_two_opaque_gaussians_hides_the_other():
    met = rays_of([[0.5, 1.0]], [[9.0, 9.0]], [0.03, 0.03])
    assert cell_visibility(met)[0].tolist() == pytest.approx([1.0, 0.0], abs=2e-3)


def test_rays_meet_gaussians_at_any_angle():
    """A Gaussian beyond 90 degrees off the camera's axis is met like any other."""
    centres = torch.tensor([[0.3, 0.0, -0.4]], dtype=F64)
    direction = centres / centres.norm()
    across = torch.tensor([[0.8, 0.0, 0.6]], dtype=F64)
    sigma, density = torch.tensor([0.05], dtype=F64), torch.tensor([10.0], dtype=F64)
    origins = torch.zeros(2, 3, dtype=F64)
    met = along_rays(centres, sigma, density, origins, torch.cat([direction, across]))
    assert met.middle[0].item() == pytest.approx(0.5)
    assert met.depth[0].item() == pytest.approx(10 * 0.05 * np.sqrt(2 * np.pi))
    assert met.depth[1].item() < 1e-9


@pytest.mark.parametrize("quadrature", [cell_visibility, sampled_visibility])
def test_derivatives_by_centres_sizes_and_densities(quadrature):
    rng = np.random.default_rng(2)
    directions = torch.as_tensor(rng.normal(size=(3, 3)))
    directions = directions / directions.norm(dim=-1, keepdim=True)
    centres = (directions * 0.6 + 0.03 * torch.as_tensor(rng.normal(size=(3, 3)))).requires_grad_()
    sigma = torch.tensor([0.03, 0.05, 0.06], dtype=F64, requires_grad=True)
    density = torch.tensor([20.0, 30.0, 15.0], dtype=F64, requires_grad=True)
    origins = torch.zeros(3, 3, dtype=F64)

    def seen(*shape):
        return quadrature(along_rays(*shape, origins, directions))

    assert torch.autograd.gradcheck(seen, (centres, sigma, density), eps=1e-7, atol=1e-5)


def test_batches_give_what_single_poses_give():
    centres = torch.as_tensor(RNG.normal(size=(4, 6, 3)) * 0.2 + [0, 0, 0.7])
    sigma, density = torch.full((6,), 0.05, dtype=F64), torch.full((6,), 20.0, dtype=F64)
    directions = torch.as_tensor(RNG.normal(size=(5, 3)) * 0.2 + [0, 0, 1.0])
    directions = directions / directions.norm(dim=-1, keepdim=True)
    origins = torch.zeros(5, 3, dtype=F64)
    together = cell_visibility(along_rays(centres, sigma, density, origins, directions))
    for one, centre in zip(together, centres, strict=True):
        alone = cell_visibility(along_rays(centre, sigma, density, origins, directions))
        torch.testing.assert_close(one, alone)


def test_absorbed_per_depth_is_smooth_through_zero():
    depth = torch.tensor([0.0, 1e-9, 9.9e-5, 1.1e-4, 1.0], dtype=F64, requires_grad=True)
    value = absorbed_per_depth(depth)
    (slope,) = torch.autograd.grad(value.sum(), depth)
    assert value[0] == 1.0 and slope[0] == pytest.approx(-0.5)
    assert torch.isfinite(slope).all()
    assert abs(slope[3] - slope[2]) < 1e-4
