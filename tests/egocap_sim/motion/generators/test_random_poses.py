"""Random poses: varied, smooth, and with no limb through the body."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from egocap.errors import InputError
from egocap_sim.core.bodies import BODIES, INDEX, PARENTS
from egocap_sim.motion.generators.pose_sampling import LEGS
from egocap_sim.motion.generators.random_poses import draw_pose
from egocap_sim.motion.generators.registry import make_motion
from egocap_sim.motion.generators.whole_pose import TOE_HEIGHT, WholePose, pose_clip
from egocap_sim.motion.kinematics.clearance import clearance, palms
from egocap_sim.motion.kinematics.clip import Clip


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


@pytest.mark.parametrize("seed", [59, 127, 18, 80, 86])  # that once reached 20 to 40 rad/s
def test_no_limb_whips_round(seed):
    R = make_motion("poses", 8.0, np.random.default_rng(seed)).rotations
    cosine = 0.5 * np.einsum("tbij,tbij->tb", R[1:], R[:-1]) - 0.5
    assert 60.0 * np.arccos(np.clip(cosine, -1.0, 1.0)).max() < 13.0


def test_joints_turn_farther_than_in_walking_and_gestures():
    def spread(name: str, body: str) -> float:
        R = make_motion(name, 30.0, np.random.default_rng(400300)).rotations[::10]
        i = INDEX[body]
        turns = Rotation.from_matrix(np.swapaxes(R[:, PARENTS[i]], -1, -2) @ R[:, i])
        return float(turns.as_rotvec().std(axis=0).max())

    for body in ("chest", "head", "l_upperarm", "r_upperarm", "l_hand", "l_calf"):
        assert spread("poses", body) > max(spread("gestures", body), spread("walk", body)), body


@pytest.mark.parametrize("kind", list(LEGS))
def test_every_kind_of_pose_is_what_it_is_called_and_stands_on_the_ground(kind):
    rng = np.random.default_rng(400310)
    poses = [draw_pose(rng, kinds=(kind,)) for _ in range(6)]
    assert sum(pose != WholePose() for pose in poses) >= 5
    for pose in (pose for pose in poses if pose != WholePose()):
        clip = pose_clip(pose)
        height = dict(zip(BODIES, clip.positions[0, :, 2], strict=True))
        toes = sorted((height["l_toe"], height["r_toe"]))
        assert toes[0] == pytest.approx(TOE_HEIGHT, abs=0.01)
        assert min(height["l_calf"], height["r_calf"]) > 0.05
        assert clearance(clip)[0] > -0.01
        assert (toes[1] > TOE_HEIGHT + 0.02) == (kind == "balance") == pose.on_one_foot
        if kind == "kneel":
            assert min(height["l_calf"], height["r_calf"]) < 0.1
        if kind == "crouch":
            assert height["pelvis"] < 0.7
        if kind == "bend":
            assert clip.rotations[0, INDEX["chest"], 2, 2] < 0.65  # leant by 50 degrees and more
        if kind == "straddle":
            ankles = clip.positions[0, [INDEX["l_foot"], INDEX["r_foot"]]]
            assert np.linalg.norm(ankles[0] - ankles[1]) > 0.45


def test_hands_touch_feet_and_floor_from_low_poses_and_the_head_from_all():
    rng = np.random.default_rng(400311)
    low, head = [], []
    for _ in range(40):
        clip = pose_clip(draw_pose(rng, kinds=("bend", "crouch", "kneel")))
        hands, _ = palms(clip)
        low.append(hands[0, :, 2].min())
        middle = clip.positions[0, INDEX["head"]] + 0.12 * clip.rotations[0, INDEX["head"], :, 2]
        head.append(np.linalg.norm(hands[0] - middle, axis=-1).min())
    assert np.mean(np.array(low) < 0.3) > 0.15
    assert np.mean(np.array(head) < 0.25) > 0.05


def test_an_unknown_kind_is_refused():
    with pytest.raises(InputError, match=r"handstand.*kneel"):
        make_motion("poses", 1.0, np.random.default_rng(0), kinds=("handstand",))
