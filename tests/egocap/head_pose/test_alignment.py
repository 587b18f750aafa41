"""Clock, axes, place, world and scale of a device against a known motion."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from egocap.errors import InputError
from egocap.geometry import inverse, rigid
from egocap.head_pose.alignment import align, aligned
from tests.egocap.head_pose.motion import T_DEVICE_HEAD, head_motion

REFERENCE = np.arange(600) / 30.0
OFFSET = 3.271
T_OWN_WORLD = rigid(Rotation.from_rotvec([0.4, 0.1, -2.0]).as_matrix(), np.array([5.0, -3.0, 1.0]))


def device(rate=47.0, scale=1.0, origin=0.0):
    """Times and poses of the device, which started later and runs at another rate."""
    common = np.arange(1.0, 18.0, 1.0 / rate)
    poses = T_OWN_WORLD @ head_motion(common) @ inverse(T_DEVICE_HEAD)
    poses[:, :3, 3] /= scale
    return common - OFFSET + origin, poses


def test_a_device_with_another_clock_world_and_mount_is_aligned():
    time, poses = device()
    found = align(time, poses, REFERENCE, head_motion(REFERENCE))
    assert found.offset_s == pytest.approx(OFFSET, abs=1e-3)
    assert found.R_device_head == pytest.approx(T_DEVICE_HEAD[:3, :3], abs=2e-3)
    assert found.t_device_head == pytest.approx(T_DEVICE_HEAD[:3, 3], abs=5e-3)
    heads = aligned(poses, found)
    expected = head_motion(time + OFFSET)
    assert np.linalg.norm(heads[:, :3, 3] - expected[:, :3, 3], axis=1).max() < 5e-3
    assert found.residual_rad < np.deg2rad(0.2)


def test_clocks_of_days_are_found_as_well():
    time, poses = device(origin=1.7e9)
    found = align(time, poses, REFERENCE, head_motion(REFERENCE))
    assert found.offset_s + 1.7e9 == pytest.approx(OFFSET, abs=2e-3)


def test_scale_is_found_where_it_is_free():
    time, poses = device(scale=3.7)
    found = align(time, poses, REFERENCE, head_motion(REFERENCE), free_scale=True)
    assert found.scale == pytest.approx(3.7, rel=2e-3)


def test_place_is_not_claimed_where_the_head_turns_about_one_axis_too_little():
    turn = Rotation.from_rotvec(0.15 * np.sin(3 * REFERENCE)[:, None] * [0, 0, 1])
    still = rigid(turn.as_matrix(), np.outer(REFERENCE, [1, 0, 0]))
    found = align(REFERENCE - 0.5, still @ inverse(T_DEVICE_HEAD), REFERENCE, still)
    assert np.isinf(found.place_std_m)
    assert (found.t_device_head == 0).all()


def test_a_head_that_does_not_turn_has_no_clock():
    still = np.tile(np.eye(4), (600, 1, 1))
    with pytest.raises(InputError, match="hardly turns"):
        align(REFERENCE, still, REFERENCE, head_motion(REFERENCE))


def test_another_motion_is_refused(rng):
    turn = np.cumsum(rng.normal(size=(600, 3)), 0) * 0.05
    other = rigid(Rotation.from_rotvec(turn).as_matrix(), np.zeros((600, 3)))
    with pytest.raises(InputError, match="do not turn alike"):
        align(REFERENCE, other, REFERENCE, head_motion(REFERENCE))
