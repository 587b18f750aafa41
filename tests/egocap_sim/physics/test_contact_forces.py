import numpy as np
import pytest
from scipy.optimize import nnls

from egocap.geometry import axis_angle, unit
from egocap_sim.physics.contact_forces import contact_forces, nonnegative_least_squares

FEET = np.array([[0.0, 0.1, 0.08], [0.15, 0.1, 0.03], [0.1, -0.1, 0.08], [0.25, -0.1, 0.03]])
PELVIS = np.array([0.05, 0.0, 0.95])
SLOPE = np.array([0.6, 0.6, 0.06, 0.06])  # the right foot slides


@pytest.mark.parametrize("seed", range(30))
def test_shares_are_those_of_the_active_set_method(seed):
    rng = np.random.default_rng(seed)
    n, r = int(rng.integers(1, 64)), float(rng.choice([0.02, 1.0]))
    C, w = rng.normal(size=(6, n)), 500.0 * rng.normal(size=6)
    C[2], w[2] = 1.0, abs(w[2]) * seed  # at first mostly not to be met
    wanted, _ = nnls(np.vstack([C, r * np.eye(n)]), np.concatenate([w, np.zeros(n)]))
    np.testing.assert_allclose(nonnegative_least_squares(C, w, r), wanted, atol=1e-6)


def contacts(rng):
    foot = np.repeat(np.arange(4), 4)
    return foot, FEET[foot] * [1, 1, 0] + rng.uniform(-0.05, 0.05, (16, 3)) * [1, 1, 0]


@pytest.mark.parametrize("seed", range(5))
def test_pushes_add_up_to_a_wrench_that_the_floor_can_give(seed):
    rng = np.random.default_rng(seed)
    foot, points = contacts(rng)
    R = axis_angle(unit(rng.normal(size=3)), 1.0)
    forces = np.zeros((16, 3))
    forces[:, 2] = rng.uniform(20.0, 60.0, 16)
    forces[:, :2] = 0.3 * (SLOPE[foot] * forces[:, 2])[:, None] * rng.uniform(-1, 1, (16, 2))
    wrench = np.concatenate([forces.sum(0), np.cross(points - PELVIS, forces).sum(0) @ R])
    plan = contact_forces(points, foot, SLOPE, FEET, PELVIS, R, wrench, 4.0, 1e-4)
    torque = (np.cross(FEET - PELVIS, plan[:, :3]) + plan[:, 3:]).sum(0) @ R
    np.testing.assert_allclose(np.concatenate([plan[:, :3].sum(0), torque]), wrench, atol=1e-3)
    assert (np.abs(plan[:, :2]) <= SLOPE[:, None] * plan[:, 2:3] + 1e-9).all()


def test_floor_neither_pulls_nor_grips_beyond_friction():
    foot, points = contacts(np.random.default_rng(0))
    pull = np.array([0.0, 0.0, -300.0, 0.0, 0.0, 0.0])
    assert not contact_forces(points, foot, SLOPE, FEET, PELVIS, np.eye(3), pull, 4.0, 0.02).any()
    drag = np.array([500.0, 0.0, 100.0, 0.0, 0.0, 0.0])
    plan = contact_forces(points, foot, SLOPE, FEET, PELVIS, np.eye(3), drag, 4.0, 0.02)
    assert (plan[:, 0] <= SLOPE * plan[:, 2] + 1e-9).all()
    assert plan[:, 0].sum() > 10.0
