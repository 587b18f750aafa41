"""The height map from footholds: floors, slopes, stairs, wrong footholds."""

import numpy as np
import pytest

from egocap.world.ground import KNOWN_M, Footholds, Ground, footholds


def laid(xy, z, weights=None):
    places = np.column_stack([xy, z])
    weights = np.ones(len(xy)) if weights is None else weights
    return Ground.learn(Footholds(places, weights, np.full(len(xy), 0.04)))


def test_a_floor_of_noisy_footholds_is_flat():
    rng = np.random.default_rng(0)
    xy = rng.uniform(-2, 2, (40, 2))
    noise = 0.01 * rng.normal(size=40)
    ground = laid(xy, 0.4 + noise)
    assert ground.level == pytest.approx(0.4, abs=0.01)
    assert (ground.height(xy) - 0.4).std() < noise.std()


def test_a_wrong_foothold_does_not_make_a_hill():
    rng = np.random.default_rng(1)
    xy = rng.uniform(-1, 1, (30, 2))
    xy[0] = xy[1]  # two stand there, one of them wrong
    z = np.zeros(30)
    z[0] = 0.12
    assert abs(laid(xy, z).height(xy[:1])[0]) < 0.03


def test_slopes_and_treads_are_followed():
    x = np.linspace(0, 5, 26)
    xy = np.column_stack([x, np.zeros(26)])
    slope = laid(xy, 0.1 * x)
    between = np.column_stack([x[:-1] + 0.1, np.zeros(25)])
    assert np.abs(slope.height(between) - 0.1 * between[:, 0]).max() < 0.01
    treads = 0.17 * np.arange(10)
    steps = np.column_stack([0.28 * np.arange(10), np.zeros(10)])
    assert np.abs(laid(steps, treads).height(steps) - treads).max() < 0.01


def test_known_near_footholds_only():
    ground = laid(np.zeros((1, 2)), np.zeros(1))
    at = np.array([[0.9 * KNOWN_M, 0.0], [1.1 * KNOWN_M, 0.0]])
    assert ground.known(at).tolist() == [True, False]
    nothing = Ground.learn(Footholds(np.zeros((0, 3)), np.zeros(0), np.zeros(0)))
    assert not nothing.known(at).any() and np.all(nothing.height(at) == 0.0)


def test_footholds_are_stretches_of_contact():
    points = np.zeros((10, 2, 3))
    points[:, 0, 0] = np.arange(10)
    points[..., 2] = 0.05
    contact = np.zeros((10, 2))
    contact[2:5, 0] = 0.9
    contact[7:, 0] = 0.6
    found = footholds(points, contact, np.full(contact.shape, 0.04), 0.03)
    assert np.allclose(found.places, [[3.0, 0.0, 0.02], [8.0, 0.0, 0.02]])
    assert (found.weights < 1.0).all()


def test_a_known_floor_takes_the_footholds_that_may_be_on_it():
    z, spread = np.array([0.0, 0.05, -0.09, 0.17, 0.34, -0.2]), np.full(6, 0.04)
    spread[5] = 0.1  # of somebody who crouches, say
    found = Footholds(np.column_stack([np.zeros((6, 2)), z]), np.ones(6), spread)
    np.testing.assert_allclose(
        found.on_floor(0.003).places[:, 2], [0.0, 0.0, 0.0, 0.17, 0.34, 0.0], atol=0.02
    )
    surer = Footholds(found.places, found.weights, 0.25 * spread)
    np.testing.assert_allclose(surer.on_floor(0.003).places[2:, 2], z[2:], atol=0.01)
