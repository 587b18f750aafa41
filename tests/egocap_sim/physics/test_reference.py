import mujoco
import numpy as np

from egocap.geometry import axis_angle, unit
from egocap_sim.core.bodies import INDEX
from egocap_sim.motion.retarget.retarget import Reference
from egocap_sim.physics.model import build_model
from egocap_sim.physics.reference import TargetMotion


def tumble(seconds=2.0, fps=50.0) -> Reference:
    """A somersault with a waving arm: every coordinate moves."""
    t = np.arange(round(seconds * fps) + 1) / fps
    R = np.tile(np.eye(3), (len(t), 21, 1, 1))
    spin = axis_angle(unit(np.array([1.0, 2.0, 3.0])), 3.0 * t + 0.5 * np.sin(4 * t))
    R = spin[:, None] @ R
    R[:, INDEX["l_upperarm"]] = spin @ axis_angle(np.array([1.0, 0, 0]), np.sin(5 * t))
    root = np.stack([np.sin(t), np.cos(2 * t), 1 + 0.2 * t], 1)
    none = np.zeros((len(t), 4), bool)
    return Reference(fps, root, R, none, none)


def test_velocities_and_accelerations_are_those_of_the_positions(stand_in):
    """Against MuJoCo's own differences of the coordinates."""
    model, dt = build_model(stand_in, 1e-4), 1e-4
    motion = TargetMotion(tumble())
    block = motion.block(0, 3, dt, 1.0)
    difference = np.zeros((2, model.nv))
    for i in range(2):
        mujoco.mj_differentiatePos(model, difference[i], dt, block.qpos[i], block.qpos[i + 1])
    np.testing.assert_allclose(block.qvel[1:], difference, atol=1e-4)
    np.testing.assert_allclose(block.qacc[1], (difference[1] - difference[0]) / dt, atol=5e-2)
    assert np.abs(block.qvel[:, 3:]).max() > 1.0


def test_quaternions_are_unit_and_poses_those_of_the_reference(stand_in):
    reference = tumble()
    block = TargetMotion(reference).block(0, 101, 0.02, 0.0)
    quaternions = block.qpos[:, 3:].reshape(101, -1, 4)
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=-1), 1.0)
    model = build_model(stand_in, 0.004)
    data = mujoco.MjData(model)
    data.qpos[:] = block.qpos[37]
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(data.xmat[1:].reshape(-1, 3, 3), reference.rotations[37], atol=1e-9)


def test_blocks_do_not_depend_on_where_they_are_cut():
    motion = TargetMotion(tumble())
    whole = motion.block(0, 100, 0.004, 0.3)
    part = motion.block(60, 40, 0.004, 0.3)
    np.testing.assert_array_equal(whole.qpos[60:], part.qpos)
    np.testing.assert_array_equal(whole.qacc[60:], part.qacc)


def test_holds_still_before_the_beginning():
    motion = TargetMotion(tumble())
    block, begins = motion.block(-10, 10, 0.01, 0.05), motion.block(0, 1, 0.01, 0.0)
    np.testing.assert_array_equal(block.qpos[:5], np.repeat(begins.qpos, 5, 0))
    assert not block.qvel[:5].any() and not block.qacc[:5].any()
    assert np.abs(block.qvel[5:]).max(1).min() > 0.5


def test_holds_still_after_the_end():
    block = TargetMotion(tumble(seconds=1.0)).block(0, 5, 0.5, 2.0)
    assert not block.qvel.any() and not block.qacc.any()
    np.testing.assert_array_equal(block.qpos[0], block.qpos[-1])
