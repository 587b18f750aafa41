"""Geometry against scipy's rotations and the definitions of the frames."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from egocap import geometry


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def random_rigid(rng, *batch):
    R = Rotation.random(int(np.prod(batch, initial=1)), rng=rng).as_matrix().reshape(*batch, 3, 3)
    return geometry.rigid(R, rng.normal(size=(*batch, 3)))


def test_world_is_right_handed_with_z_up():
    assert np.allclose(np.cross(geometry.FORWARD, geometry.LEFT), geometry.UP)
    assert geometry.GRAVITY @ geometry.UP < 0


def test_inverse_undoes_a_transform(rng):
    T = random_rigid(rng, 4, 3)
    points = rng.normal(size=(4, 3, 7, 3))
    back = geometry.transform(geometry.inverse(T), geometry.transform(T, points))
    assert np.allclose(back, points)
    assert np.allclose(geometry.inverse(T), np.linalg.inv(T))


def test_transforms_chain(rng):
    T_a_b, T_b_c = random_rigid(rng), random_rigid(rng)
    points = rng.normal(size=(5, 3))
    step_by_step = geometry.transform(T_a_b, geometry.transform(T_b_c, points))
    assert np.allclose(geometry.transform(T_a_b @ T_b_c, points), step_by_step)


def test_axis_angle_is_scipys_rotation_vector(rng):
    axis, angle = geometry.unit(rng.normal(size=(6, 3))), rng.uniform(-4, 4, 6)
    expected = Rotation.from_rotvec(axis * angle[:, None]).as_matrix()
    assert np.allclose(geometry.axis_angle(axis, angle), expected)


def test_quaternions_round_trip_and_are_scalar_first(rng):
    R = Rotation.random(20, rng=rng)
    q = geometry.matrix_to_quaternion(R.as_matrix())
    assert np.allclose(q, R.as_quat(canonical=True, scalar_first=True))
    assert np.allclose(geometry.quaternion_to_matrix(3.0 * q), R.as_matrix())


def test_a_zero_vector_stays_zero():
    assert np.array_equal(geometry.unit(np.zeros(3)), np.zeros(3))
