import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from egocap.geometry import axis_angle, unit
from egocap_sim.motion.kinematics import vectors
from egocap_sim.motion.kinematics.curves import turn
from egocap_sim.motion.kinematics.limbs import shortest_arc

RNG = np.random.default_rng(0)
ANGLES = RNG.uniform(-3.0, 3.0, (20, 3))
WAYS = unit(RNG.normal(size=(20, 2, 3)))


def matrix(axes):
    return np.array(axes).T


@pytest.mark.parametrize("angles", ANGLES)
def test_turned_rolls_then_pitches_then_yaws(angles):
    wanted = Rotation.from_euler("ZYX", angles).as_matrix()
    np.testing.assert_allclose(matrix(vectors.turned(*angles)), wanted, atol=1e-14)
    np.testing.assert_allclose(turn(*angles), wanted, atol=1e-14)


@pytest.mark.parametrize(("a", "b"), WAYS)
def test_rotations_are_those_of_arrays(a, b):
    R, S = axis_angle(a, 0.7), shortest_arc(a, b)
    np.testing.assert_allclose(matrix(vectors.about(tuple(a), 0.7)), R, atol=1e-14)
    np.testing.assert_allclose(matrix(vectors.arc(tuple(a), tuple(b))), S, atol=1e-12)
    product = vectors.product(vectors.axes(R), vectors.axes(S))
    np.testing.assert_allclose(matrix(product), R @ S, atol=1e-14)
    np.testing.assert_allclose(vectors.applied(vectors.axes(R), tuple(b)), R @ b, atol=1e-14)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 1.0, 3.0])
def test_part_way_is_a_share_of_the_turn(angle):
    A = Rotation.from_euler("ZYX", ANGLES[0])
    B = A * Rotation.from_rotvec(angle * WAYS[0, 0])
    wanted = Slerp([0.0, 1.0], Rotation.concatenate([A, B]))(0.45).as_matrix()
    found = vectors.part_way(vectors.axes(A.as_matrix()), vectors.axes(B.as_matrix()), 0.45)
    np.testing.assert_allclose(matrix(found), wanted, atol=1e-12)


def test_what_has_no_direction_stays_as_it_is():
    assert vectors.unit((0.0, 0.0, 0.0)) == (0.0, 0.0, 0.0)
    assert np.isfinite(matrix(vectors.arc((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)))).all()
