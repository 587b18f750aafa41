"""Targets decode to the points they were made of; modes come in order; torch and numpy agree."""

import numpy as np
import pytest
import torch

from egocap.detect.heatmaps import decode, modes, soft_points, targets, to_cells, to_pixels


def logits(points: np.ndarray, sigma: float, shape=(56, 64), stride=4) -> np.ndarray:
    made = targets(torch.from_numpy(points), shape, stride, torch.full(points.shape[:-1], sigma))
    return torch.log(made.clamp(min=1e-30)).numpy()


def test_cells_and_pixels_undo_each_other():
    assert to_pixels(0.0, 4) == 1.5  # the first cell covers pixels 0 to 3
    assert to_cells(to_pixels(7.25, 8), 8) == pytest.approx(7.25)


@pytest.mark.parametrize("stride", [4, 8])
@pytest.mark.parametrize("sigma", [0.75, 1.25])
def test_targets_decode_to_their_points(stride, sigma):
    rng = np.random.default_rng(0)
    points = rng.uniform(20 * stride / 4, 180 * stride / 4, (5, 18, 2))
    found = decode(logits(points, sigma, stride=stride), stride)
    np.testing.assert_allclose(found.points, points, atol=0.03 * stride)
    assert (found.weight > 0.98).all()


def test_targets_sum_to_one_even_at_the_border():
    points = torch.tensor([[-0.5, -0.5], [255.0, 223.0]])
    made = targets(points, (56, 64), 4, torch.ones(2))
    torch.testing.assert_close(made.sum((-2, -1)), torch.ones(2))


def test_torch_decodes_as_numpy():
    rng = np.random.default_rng(1)
    heat = rng.normal(0, 2, (3, 18, 14, 16)).astype(np.float32)
    found = soft_points(torch.from_numpy(heat), 4)
    np.testing.assert_allclose(found.numpy(), decode(heat, 4).points, atol=1e-3)


def test_soft_points_pull_the_peak_towards_a_target():
    heat = torch.from_numpy(logits(np.array([[100.0, 90.0]]), 1.0)).float().clamp(min=-20)
    heat.requires_grad_()
    soft_points(heat, 4)[0, 0].backward()
    assert heat.grad is not None
    gradient = heat.grad[0]
    right, left = to_cells(104.0, 4), to_cells(96.0, 4)
    row = round(to_cells(90.0, 4))
    assert gradient[row, round(right)] > 0 > gradient[row, round(left)]


def test_modes_come_heaviest_first_and_end():
    near, far = np.array([[60.0, 60.0]]), np.array([[180.0, 150.0]])
    p = 0.7 * np.exp(logits(near, 1.0)) + 0.3 * np.exp(logits(far, 1.0))
    found = modes(np.log(p + 1e-30), 4, 3)
    assert found.points.shape == (1, 3, 2)
    np.testing.assert_allclose(found.points[0, 0], near[0], atol=0.2)
    np.testing.assert_allclose(found.points[0, 1], far[0], atol=0.2)
    np.testing.assert_allclose(found.weight[0], [0.7, 0.3, 0.0], atol=0.02)


def test_any_leading_axes():
    heat = np.random.default_rng(2).normal(size=(2, 3, 18, 14, 16))
    whole = decode(heat, 4)
    assert whole.points.shape == (2, 3, 18, 2) and whole.weight.shape == (2, 3, 18)
    np.testing.assert_array_equal(whole.points[1, 2], decode(heat[1, 2], 4).points)
