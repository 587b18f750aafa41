"""Random poses: varied, smooth, and with no limb through the body."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from egocap_sim.bodies import INDEX, PARENTS
from egocap_sim.motion.clearance import clearance
from egocap_sim.motion.clip import Clip
from egocap_sim.motion.procedural import make_motion


@pytest.fixture(scope="module")
def clip() -> Clip:
    return make_motion("poses", 60.0, np.random.default_rng(11))


def test_hands_go_everywhere_within_reach(clip):
    chest = clip.rotations[:, INDEX["chest"]]
    wrist = np.concatenate([
        np.einsum("tji,tj->ti", chest, clip.positions[:, INDEX[s + "hand"]]
                  - clip.positions[:, INDEX[s + "upperarm"]]) * [1.0, sign, 1.0]
        for s, sign in (("l_", 1.0), ("r_", -1.0))
    ])  # fmt: skip
    assert wrist[:, 2].max() > 0.25 and wrist[:, 2].min() < -0.3  # above and below the shoulder
    assert wrist[:, 0].max() > 0.4 and wrist[:, 1].max() > 0.35  # ahead, and out to the side
    assert wrist.std(0).min() > 0.1
    nose = clip.rotations[:, INDEX["head"], :, 0]
    assert np.abs(nose[:, 1]).max() > 0.6


def test_no_arm_passes_through_the_body(clip):
    assert np.mean(clearance(clip) > -0.03) > 0.9


def test_moves_are_smooth(clip):
    speed = np.linalg.norm(np.diff(clip.positions, axis=0), axis=-1) * clip.fps
    assert speed.max() < 6.0
    assert np.median(speed[:, INDEX["l_hand"]]) > 0.05


def test_joints_turn_farther_than_in_walking_and_gestures():
    def spread(name: str, body: str) -> float:
        R = make_motion(name, 30.0, np.random.default_rng(400300)).rotations[::10]
        i = INDEX[body]
        turns = Rotation.from_matrix(np.swapaxes(R[:, PARENTS[i]], -1, -2) @ R[:, i])
        return float(turns.as_rotvec().std(axis=0).max())

    for body in ("chest", "head", "l_upperarm", "r_upperarm", "l_hand", "l_calf"):
        assert spread("poses", body) > max(spread("gestures", body), spread("walk", body)), body
