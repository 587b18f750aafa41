"""Laplacian smoothing on patches against dense matrices."""

import numpy as np
import pytest

from egocap_sim.human.body.anny_model import anatomy
from egocap_sim.human.body.skin_patch import make_patch
from egocap_sim.human.clothing.shell import skin_weights


def inside():
    return np.arange(len(anatomy().owner)) % 3 > 0


def test_smoothed_is_half_the_mean_of_the_neighbours_inside():
    mask, faces = inside(), anatomy().faces
    n = len(mask)
    joined = np.zeros((n, n), bool)
    for i in range(3):
        joined[faces[:, i], faces[:, i - 1]] = joined[faces[:, i - 1], faces[:, i]] = True
    joined &= mask[:, None] & mask[None, :]
    values = np.random.default_rng(0).normal(size=(n, 2))
    count = joined.sum(1, keepdims=True)
    expected = np.where(
        count > 0, 0.5 * values + 0.5 * (joined @ values) / np.maximum(count, 1), values
    )
    assert make_patch(mask).smoothed(values, 1) == pytest.approx(expected)


def test_rounds_follow_each_other():
    patch = make_patch(inside())
    values = np.random.default_rng(0).normal(size=(len(anatomy().owner), 3))
    twice = patch.smoothed(patch.smoothed(values, 1), 1)
    assert np.array_equal(patch.smoothed(values, 2), twice)


def test_smoothed_weights_still_sum_to_one():
    weights = make_patch(inside()).smoothed(skin_weights(), 4)
    assert weights.sum(1) == pytest.approx(1)


def test_smoothed_points_keep_their_distance():
    mask = inside()
    patch, n = make_patch(mask), len(mask)
    rng = np.random.default_rng(0)
    skin = rng.normal(size=(n, 3))
    normals = np.tile([0.0, 0.6, 0.8], (n, 1))
    least = rng.uniform(0, 0.1, n)
    moved = patch.smoothed_over(skin, skin, normals, least, 3)
    distance = ((moved - skin) * normals).sum(1)
    assert (distance - least)[patch.vertices].min() > -1e-12
    assert np.array_equal(moved[~mask], skin[~mask])
