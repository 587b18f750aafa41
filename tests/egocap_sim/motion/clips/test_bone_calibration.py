from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from egocap.errors import InputError
from egocap_sim.core.bodies import BODIES, INDEX
from egocap_sim.motion import make_motion
from egocap_sim.motion.clips.bone_calibration import bone_frames, calibrate
from egocap_sim.motion.kinematics.clip import Clip


def degrees_off(a, b):
    """Angle between rotations, (T, 21) degrees."""
    R = Rotation.from_matrix((np.swapaxes(a, -1, -2) @ b).reshape(-1, 3, 3))
    return np.degrees(R.magnitude()).reshape(a.shape[:2])


def disguised(clip: Clip, seed: int = 0) -> Clip:
    """The clip under arbitrary bone frames."""
    frames = Rotation.random(21, random_state=seed).as_matrix()
    return dataclasses.replace(clip, rotations=clip.rotations @ frames, canonical=False)


@pytest.mark.parametrize("seed", [0, 1])
def test_arbitrary_bone_frames_are_undone(active: Clip, seed: int) -> None:
    found = calibrate(disguised(active, seed))
    off = degrees_off(active.rotations, found.rotations).max(0)
    assert found.canonical
    for body in BODIES:
        # Nothing in a rig without fingers says which way the average palm faces.
        limit = 35.0 if body.endswith(("hand", "forearm")) else 8.0
        assert off[INDEX[body]] < limit, (body, off[INDEX[body]])
    legs = [INDEX[s + b] for s in ("l_", "r_") for b in ("thigh", "calf", "foot", "toe")]
    assert off[legs].max() < 4.0


def test_the_choice_of_bone_frames_does_not_matter(active: Clip) -> None:
    a, b = calibrate(disguised(active, 3)), calibrate(disguised(active, 4))
    assert degrees_off(a.rotations, b.rotations).max() < 1e-4


def test_turning_the_world_turns_the_result(active: Clip) -> None:
    turn = Rotation.from_euler("z", 130, degrees=True).as_matrix()
    clip = disguised(active)
    turned = dataclasses.replace(
        clip, positions=clip.positions @ turn.T, rotations=turn @ clip.rotations
    )
    assert np.allclose(bone_frames(clip), bone_frames(turned), atol=1e-6)


def test_limbs_that_never_bend_swing_without_twist() -> None:
    idle = make_motion("idle", 3.0, np.random.default_rng(0), 30.0)
    off = degrees_off(idle.rotations, calibrate(disguised(idle)).rotations)
    limbs = [INDEX[s + b] for s in ("l_", "r_") for b in ("thigh", "calf", "upperarm")]
    assert off[:, limbs].max() < 25.0


def test_fingers_tell_how_the_hand_is_turned(active: Clip) -> None:
    clip = disguised(active)
    K = np.swapaxes(clip.rotations[0], -1, -2) @ active.rotations[0]
    hands = {
        b: {"up": K[INDEX[b]][:, 2], "forward": K[INDEX[b]][:, 0]} for b in ("l_hand", "r_hand")
    }
    off = degrees_off(active.rotations, calibrate(clip, hands).rotations)
    assert off[:, [INDEX["l_hand"], INDEX["r_hand"]]].max() < 1e-3


def test_a_stoop_stays_a_stoop() -> None:
    clip = make_motion("reach_low", 6.0, np.random.default_rng(2), 30.0)
    found = calibrate(disguised(clip))
    pitch = np.degrees(np.arcsin(-found.rotations[:, INDEX["chest"], 2, 0]))
    true = np.degrees(np.arcsin(-clip.rotations[:, INDEX["chest"], 2, 0]))
    assert np.abs(pitch - true).max() < 8.0 and true.max() > 35.0


def test_exchanged_sides_are_refused(active: Clip) -> None:
    other = {"l_": "r_", "r_": "l_"}
    swap = [INDEX[other.get(b[:2], b[:2]) + b[2:]] for b in BODIES]
    clip = disguised(active)
    wrong = dataclasses.replace(
        clip, positions=clip.positions[:, swap], rotations=clip.rotations[:, swap]
    )
    with pytest.raises(InputError, match="knees bend forward"):
        calibrate(wrong)


def test_a_single_frame_is_no_crash(active: Clip) -> None:
    clip = disguised(active)
    one = dataclasses.replace(clip, positions=clip.positions[:1], rotations=clip.rotations[:1])
    R = calibrate(one).rotations
    assert np.allclose(R @ np.swapaxes(R, -1, -2), np.eye(3), atol=1e-9)
