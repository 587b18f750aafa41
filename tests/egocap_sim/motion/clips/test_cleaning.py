from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from egocap_sim.core.bodies import INDEX
from egocap_sim.motion.clips.cleaning import (
    despike,
    floor_height,
    longest_take,
    put_on_floor,
    repair_beyond_limits,
    to_local,
    with_local_rotations,
)  # fmt: skip
from egocap_sim.motion.kinematics.clip import Clip


def spiked(clip: Clip, body: str, frames: slice, degrees: float) -> Clip:
    local = to_local(clip.rotations)
    turn = Rotation.from_euler("x", degrees, degrees=True).as_matrix()
    local[frames, INDEX[body]] = local[frames, INDEX[body]] @ turn
    return with_local_rotations(clip, local)


def test_clean_motion_is_untouched(active: Clip) -> None:
    clip, count = despike(active)
    assert count == 0 and clip is active
    clip, count = repair_beyond_limits(active)
    assert count == 0 and clip is active
    assert longest_take(active)[1] == 0


def test_spikes_and_glitches_go(active: Clip) -> None:
    bad = spiked(spiked(active, "l_hand", slice(50, 51), 90), "r_foot", slice(100, 112), 170)
    assert np.abs(bad.positions - active.positions).max() > 0.05
    clip, count = despike(bad)
    assert 13 <= count < 40
    assert np.abs(clip.positions - active.positions).max() < 0.03


def test_impossible_joints_are_interpolated(active: Clip) -> None:
    bad = spiked(active, "l_foot", slice(200, 230), 120)
    clip, count = repair_beyond_limits(bad)
    assert count == 30
    angle = Rotation.from_matrix(to_local(clip.rotations)[:, INDEX["l_foot"]]).magnitude()
    assert angle.max() < 1.45


def test_a_joint_that_is_always_impossible_is_held_still(active: Clip) -> None:
    clip, _ = repair_beyond_limits(spiked(active, "l_foot", slice(None), 150))
    still = to_local(clip.rotations)[:, INDEX["l_foot"]]
    np.testing.assert_allclose(still, np.broadcast_to(np.eye(3), still.shape), atol=1e-6)


def test_a_bind_pose_in_front_is_cut_off(active: Clip) -> None:
    R = np.concatenate([np.broadcast_to(np.eye(3), (5, 21, 3, 3)), active.rotations])
    p = np.concatenate([np.repeat(active.positions[:1] + 3.0, 5, 0), active.positions])
    clip, left_out = longest_take(dataclasses.replace(active, positions=p, rotations=R))
    assert left_out == 5
    np.testing.assert_array_equal(clip.positions, active.positions)


def test_floor(active: Clip) -> None:
    assert abs(floor_height(active)) < 0.015
    raised = dataclasses.replace(active, positions=active.positions + [1.0, 2.0, 0.7])
    clip, shift = put_on_floor(raised)
    assert abs(shift + 0.7) < 0.015 and abs(floor_height(clip)) < 1e-9
