"""Contact and head terms: derivatives against finite differences, bands against dense sums."""

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from scipy.spatial.transform import Rotation

from egocap.body.proportions import Proportions
from egocap.body.skeleton import DOF_COUNT, SPREAD, jacobian
from egocap.geometry import exponential, right_jacobian, rigid
from egocap.world.contact_energy import ContactTerms, contact_system, widen
from egocap.world.foot_points import SOLE_M, STATE, FootPoints, correct, with_heels

PERSON = Proportions.from_lengths(1.75)
FEET = FootPoints.of(PERSON)
FRAMES = 4


def drawn(seed=0):
    rng = np.random.default_rng(seed)
    state = np.concatenate(
        [0.4 * SPREAD * rng.normal(size=(FRAMES, DOF_COUNT)), 0.05 * rng.normal(size=(FRAMES, 6))],
        axis=1,
    )
    turn = Rotation.from_rotvec(0.4 * rng.normal(size=(FRAMES, 3))).as_matrix()
    T = rigid(turn, rng.normal(size=(FRAMES, 3)) + [0, 0, 1.5])
    points, _ = FEET.in_world(state, T)
    terms = ContactTerms(
        T, rng.uniform(10, 200, (FRAMES - 1, 4)), rng.uniform(0, 100, (FRAMES, 4)),
        rng.uniform(50, 200, (FRAMES, 4)),
        points[..., 2] - SOLE_M + rng.choice([-0.05, 0.05], (FRAMES, 4)),
        rng.uniform(0.2, 0.9, FRAMES - 1), np.repeat([0.01, 0.02], 3),
    )  # fmt: skip
    return state, T, terms


def dense(bands, size):
    matrix = np.zeros((size, size))
    for k in range(len(bands)):
        for i in range(size - k):
            matrix[i + k, i] = matrix[i, i + k] = bands[k, i]
    return matrix


def test_points_and_their_derivatives():
    state, T, _ = drawn()
    _, J = FEET.in_world(state, T)
    for t in range(2):
        for k in range(4):
            for axis in range(3):
                slope = approx_fprime(
                    state[t],
                    lambda x, t=t, k=k, a=axis: FEET.in_world(x[None], T[t : t + 1])[0][0, k, a],
                    1e-7,
                )
                assert np.allclose(J[t, k, axis], slope, atol=2e-6)
    # Toes and heels are the feet's end points of two skeletons.
    for columns, person in (([1, 3], PERSON), ([0, 2], with_heels(PERSON))):
        labels, _ = jacobian(person, state[:, :DOF_COUNT])
        head, _ = FEET.in_head(state[:, :DOF_COUNT])
        assert np.allclose(head[:, columns], labels[:, [13, 17]])


def test_a_flat_foot_has_heel_and_toe_at_one_height():
    head, _ = FEET.in_head(np.zeros((1, DOF_COUNT)))
    assert np.allclose(head[0, 0, 2], head[0, 1, 2])
    assert head[0, 0, 0] < head[0, 1, 0] - 0.1


def test_gradient_is_that_of_the_energy():
    state, _, terms = drawn()
    _, _, gradient = contact_system(state, FEET, terms)

    def energy(x):
        return contact_system(x.reshape(state.shape), FEET, terms)[0]

    assert energy(state.ravel()) > 1.0
    step = 1e-6 * np.eye(state.size)
    slope = [(energy(state.ravel() + s) - energy(state.ravel() - s)) / 2e-6 for s in step]
    assert np.allclose(gradient, slope, rtol=1e-5, atol=1e-3)


def test_matrix_is_that_of_the_linearised_residuals():
    state, T, terms = drawn()
    points, J = FEET.in_world(state, T)
    rows = []
    for t in range(FRAMES):
        for k in range(4):
            above = points[t, k, 2] - terms.ground[t, k] - SOLE_M
            for weight in (terms.height[t, k], terms.sink[t, k] if above < 0 else 0.0):
                row = np.zeros((FRAMES, STATE))
                row[t] = weight * J[t, k, 2]
                rows.append(row.ravel())
            for axis in range(3) if t + 1 < FRAMES else ():
                row = np.zeros((FRAMES, STATE))
                row[t], row[t + 1] = -J[t, k, axis], J[t + 1, k, axis]
                rows.append(terms.slide[t, k] * row.ravel())
    for i in range(6):
        for t in range(FRAMES):
            row = np.zeros((FRAMES, STATE))
            spread = terms.head_sigma[i]
            if t:
                spread *= np.sqrt(1 - terms.keep[t - 1] ** 2)
                row[t - 1, DOF_COUNT + i] = -terms.keep[t - 1]
            row[t, DOF_COUNT + i] = 1.0
            rows.append(row.ravel() / spread)
    _, bands, _ = contact_system(state, FEET, terms)
    R = np.array(rows)
    assert np.allclose(dense(bands, state.size), R.T @ R, rtol=1e-9, atol=1e-6)


def test_the_heads_error_has_the_stated_deviation_in_every_frame():
    state, _, terms = drawn()
    nothing = np.zeros_like(terms.height)
    free = ContactTerms(terms.T_world_head, nothing[1:], nothing, nothing, terms.ground,
                        terms.keep, terms.head_sigma)  # fmt: skip
    _, bands, _ = contact_system(state, FEET, free)
    matrix = dense(bands, state.size)
    rows = np.concatenate([np.arange(DOF_COUNT, STATE) + t * STATE for t in range(FRAMES)])
    covariance = np.linalg.inv(matrix[np.ix_(rows, rows)])
    assert np.allclose(np.sqrt(np.diag(covariance)), np.tile(terms.head_sigma, FRAMES))
    ahead = covariance[:6, 6:12].diagonal() / terms.head_sigma**2
    assert np.allclose(ahead, terms.keep[0])


def test_widened_band_is_the_same_matrix_with_gaps():
    rng = np.random.default_rng(1)
    size = FRAMES * DOF_COUNT
    bands = rng.normal(size=(2 * DOF_COUNT + 1, size))
    for k in range(len(bands)):
        bands[k, size - k :] = 0.0
    rows = np.concatenate([np.arange(DOF_COUNT) + t * STATE for t in range(FRAMES)])
    wide = dense(widen(bands), FRAMES * STATE)
    assert np.allclose(wide[np.ix_(rows, rows)], dense(bands, size))
    assert np.count_nonzero(wide) == np.count_nonzero(dense(bands, size))


@pytest.mark.parametrize("size", [0.0, 1e-7, 0.3, 2.0])
def test_rotations_against_scipy(size):
    turn = size * np.array([[0.6, 0.0, -0.8], [0.0, 1.0, 0.0]])
    assert np.allclose(exponential(turn), Rotation.from_rotvec(turn).as_matrix())
    d = 1e-6 * np.array([0.3, -0.7, 0.2])
    ahead = exponential(turn + d)
    near = exponential(turn) @ exponential(right_jacobian(turn) @ d)
    assert np.abs(ahead - near).max() < 1e-11


def test_only_known_head_poses_are_corrected():
    state, T, _ = drawn()
    known = np.array([True, False, True, True])
    fixed = correct(T, state[:, DOF_COUNT:], known)
    assert np.array_equal(fixed[1], T[1]) and not np.allclose(fixed[0], T[0])
    assert np.allclose(fixed[0, :3, 3], T[0, :3, 3] + state[0, -3:])
