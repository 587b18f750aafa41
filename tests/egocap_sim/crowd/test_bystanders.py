"""Bystanders: free of collisions, without foot sliding, reproducible."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from pydantic import ValidationError

from egocap.errors import InputError
from egocap.geometry import inverse, rigid
from egocap_sim.assets.mesh import Actor, moving
from egocap_sim.assets.primitives import box
from egocap_sim.assets.textures import even
from egocap_sim.core.bodies import FEET, INDEX
from egocap_sim.crowd import bystanders
from egocap_sim.crowd.bystanders import BEHAVIOURS, make_bystanders
from egocap_sim.human.body.limb_distances import apart, limb_points
from egocap_sim.human.body.soles import sole_points
from egocap_sim.motion.generators.registry import make_motion
from egocap_sim.motion.retarget.retarget import retarget, sample_reference
from egocap_sim.scene.config import OthersTable

TIMES = np.arange(90) / 30


@pytest.fixture(scope="module")
def wearer(stand_in) -> np.ndarray:
    clip = make_motion("gestures", 4.0, np.random.default_rng(1))
    return sample_reference(stand_in, retarget(clip, stand_in), TIMES)


@pytest.fixture
def cast(monkeypatch, stand_in):
    """Replace dressed people, which take half a second each, by a bare one."""

    def make(seed, *, bystander, name):
        assert bystander
        return SimpleNamespace(**vars(stand_in) | {"name": name, "actor": Actor(name, ())})

    monkeypatch.setattr(bystanders, "make_person", make)


def others(wearer, seed=3, bounds=4.0, **table):
    return make_bystanders(
        OthersTable(**table),
        np.random.default_rng(seed),
        TIMES,
        wearer,
        bounds,
        cameras(wearer),
    )


def cameras(wearer) -> np.ndarray:
    """Two cameras 0.4 m ahead of the head."""
    head = wearer[:, INDEX["head"], :3, 3]
    return head[:, None] + [[0.4, 0.2, 0.2], [0.4, -0.2, 0.2]]


def bodies_of(extra, person) -> np.ndarray:
    return extra.skinning @ inverse(rigid(np.eye(3), -person.joints))


def test_people_keep_their_distance(wearer, cast, stand_in):
    crowd = others(wearer, count=6)
    everyone = [limb_points(b) for b in (wearer, *(bodies_of(e, stand_in) for e in crowd))]
    for i, one in enumerate(everyone):
        assert all(apart(one, other, 0.15).all() for other in everyone[:i])
    for one in everyone[1:]:
        eyes = cameras(wearer)[:, None]
        assert np.linalg.norm(one[:, :, None] - eyes, axis=-1).min() > 0.3
        assert np.linalg.norm(one[..., :2], axis=-1).max() < 4.2


@pytest.mark.parametrize("behaviour", ["stand", "walk_by", "approach"])
def test_nobody_stands_in_a_thing(wearer, cast, stand_in, behaviour):
    """A counter drives past on the wearer's left; the right side is free."""
    path = np.tile(np.eye(4), (len(TIMES), 1, 1, 1))
    path[:, 0, 0, 3] = np.linspace(0, 2, len(TIMES))
    meshes = [(0, box("top", (0, 2.0, 0.9), (1, 2.6, 0.2), even(0.5)))]
    crowd = make_bystanders(
        OthersTable(count=3, behaviours=(behaviour,)), np.random.default_rng(3), TIMES, wearer,
        4.0, cameras(wearer), things=[moving("counter", meshes, path)],
    )  # fmt: skip
    for extra in crowd:
        at = limb_points(bodies_of(extra, stand_in)) - path[:, :1, 0:3, 3]
        outside = np.abs(at - [0, 2.0, 0.9]) - [0.5, 1.3, 0.1]
        assert np.linalg.norm(np.maximum(outside, 0), axis=-1).min() > 0.1


@pytest.mark.parametrize("behaviour", BEHAVIOURS)
def test_standing_feet_do_not_slide(wearer, cast, stand_in, behaviour):
    (extra,) = others(wearer, count=1, behaviours=(behaviour,), farthest_m=3.0)
    bodies = bodies_of(extra, stand_in)
    soles = sole_points(stand_in, bodies[..., :3, 3], bodies[..., :3, :3])
    assert soles.shape[1] == len(FEET)
    low = np.maximum(soles[1:, ..., 2], soles[:-1, ..., 2]) < 0.004
    speed = np.linalg.norm(np.diff(soles[..., :2], axis=0), axis=-1) * 30
    assert np.median(speed[low]) < 0.05
    assert -0.02 < soles[..., 2].min() < 0.01  # they neither float nor sink
    assert (bodies[:, INDEX["head"], 2, 3] > 1.3).all()


def test_the_same_generator_gives_the_same_crowd(wearer, cast):
    one, two = (others(wearer, count=4) for _ in range(2))
    for a, b in zip(one, two, strict=True):
        assert a.actor.name == b.actor.name
        np.testing.assert_array_equal(a.skinning, b.skinning)


def test_too_many_people_raise(wearer, cast):
    with pytest.raises(InputError, match="no room for person"):
        others(wearer, count=12, bounds=1.2, nearest_m=0.6, farthest_m=0.9)


def test_invalid_tables_raise():
    with pytest.raises(ValidationError, match="farthest_m"):
        OthersTable(count=1, nearest_m=2.0, farthest_m=1.0)
    with pytest.raises(ValidationError, match="12"):
        OthersTable(count=13)
    with pytest.raises(ValidationError, match="walk_by"):
        OthersTable(count=1, behaviours=("dance",))
