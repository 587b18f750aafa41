"""Inertial measurements of motions whose derivatives are known."""

import numpy as np
from scipy.spatial.transform import Rotation

from egocap.geometry import rigid
from egocap_sim.export.imu import ideal_imu

TIMES = np.arange(91) / 30


def test_a_head_at_rest_measures_gravity_in_its_own_axes():
    tilt = Rotation.from_euler("y", 30, degrees=True).as_matrix()  # looking down
    still = rigid(np.broadcast_to(tilt, (91, 3, 3)), np.zeros((91, 3)))
    at, gyro, force = ideal_imu(TIMES, still, 200.0)
    assert len(at) == 601 and np.allclose(np.diff(at), 0.005)
    assert np.allclose(gyro, 0.0, atol=1e-9)
    assert np.allclose(force, 9.81 * np.array([-0.5, 0.0, np.sqrt(0.75)]), atol=1e-9)


def test_turning_on_a_circle():
    rate, radius = 0.8, 2.0
    turn = Rotation.from_euler("z", rate * TIMES[:, None]).as_matrix()
    place = radius * np.stack([np.sin(rate * TIMES), -np.cos(rate * TIMES), 0 * TIMES], -1)
    _, gyro, force = ideal_imu(TIMES, rigid(turn, place), 200.0)
    inner = slice(40, -40)
    assert np.allclose(gyro[inner], [0.0, 0.0, rate], atol=1e-4)
    # Towards the centre, which is on the left; forward speed is constant.
    assert np.allclose(force[inner], [0.0, rate**2 * radius, 9.81], atol=2e-3)
