"""Handshakes: detection of the extended hand, and contact of the palms."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from egocap.geometry import inverse, rigid, transform
from egocap_sim.assets.mesh import Actor
from egocap_sim.core.bodies import INDEX
from egocap_sim.crowd import bystanders
from egocap_sim.crowd.bystanders import make_bystanders
from egocap_sim.crowd.handshaking import find_handshake, handshake_clip, partner_pose, reach_palm
from egocap_sim.human.body.limb_distances import limb_points
from egocap_sim.motion.generators.registry import make_motion
from egocap_sim.motion.retarget.palms import find_palm
from egocap_sim.motion.retarget.retarget import retarget, sample_reference
from egocap_sim.scene.config import OthersTable

TIMES = np.arange(180) / 30


def played(person, name: str) -> np.ndarray:
    clip = make_motion(name, 7.0, np.random.default_rng(2))
    return sample_reference(person, retarget(clip, person), TIMES)


@pytest.fixture(scope="module")
def wearer(stand_in) -> np.ndarray:
    return played(stand_in, "handshake")


def test_right_palms_meet_while_the_hand_is_extended(stand_in, wearer):
    handshake = find_handshake(stand_in, wearer)
    assert handshake is not None and 0.1 < (handshake.share > 0.95).mean() < 0.9
    clip = handshake_clip(handshake, TIMES, np.random.default_rng(0), 60.0)
    local = sample_reference(stand_in, retarget(clip, stand_in), TIMES)
    other = reach_palm(handshake, stand_in, partner_pose(handshake, stand_in) @ local, 30.0)
    palm = find_palm(stand_in, "r")
    theirs = transform(other[:, palm.body], palm.centre[None])[:, 0]
    gap = np.linalg.norm(theirs - handshake.palm, axis=1)
    out = handshake.share > 0.99
    assert np.median(gap[out]) < 0.01 and np.percentile(gap[out], 90) < 0.06
    assert gap[handshake.share < 0.01].mean() > 0.15  # and part again
    # Face to face, at arm's length, the palms towards each other.
    assert 0.7 < np.linalg.norm(other[:, 0, :2, 3] - wearer[:, 0, :2, 3], axis=1).mean() < 1.5
    chests = [b[out][:, INDEX["chest"], :2, 0] for b in (wearer, other)]
    assert (chests[0] * chests[1]).sum(1).max() < -0.5
    normals = [b[out][:, palm.body, :3, :3] @ palm.normal for b in (wearer, other)]
    assert np.median((normals[0] * normals[1]).sum(1)) < -0.7


def test_no_handshake_without_an_extended_hand(stand_in):
    assert find_handshake(stand_in, played(stand_in, "idle")) is None
    assert find_handshake(stand_in, played(stand_in, "wave")) is None


def test_crowd_contains_a_handshake(stand_in, wearer, monkeypatch):
    def make(seed, *, bystander, name):  # in place of a dressed person, who takes long
        return SimpleNamespace(**vars(stand_in) | {"name": name, "actor": Actor(name, ())})

    monkeypatch.setattr(bystanders, "make_person", make)
    table = OthersTable(count=2, behaviours=("shake_hands", "gesture"), farthest_m=2.5)
    eyes = wearer[:, None, INDEX["head"], :3, 3] + [[0.2, 0.15, 0.2], [0.2, -0.15, 0.2]]
    rng = np.random.default_rng(5)
    crowd = make_bystanders(table, rng, TIMES, wearer, 4.0, eyes, person=stand_in)
    hand = wearer[:, None, INDEX["r_hand"], :3, 3]
    rest = inverse(rigid(np.eye(3), -stand_in.joints))
    near = [np.linalg.norm(limb_points(e.skinning @ rest) - hand, axis=-1).min() for e in crowd]
    assert near[0] < 0.15 < near[1]
    assert crowd[0].joints is not None and crowd[0].joints.shape == (180, 18, 3)
