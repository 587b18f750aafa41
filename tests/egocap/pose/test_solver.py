"""Levenberg-Marquardt: its linear algebra, its minimum, its honesty about convergence."""

import numpy as np
import pytest
from scipy.optimize import minimize

from egocap.body.skeleton import forward
from egocap.pose import energy, kernel
from egocap.pose.config import TrackerConfig
from egocap.pose.observations import observe
from egocap.pose.solver import NO_PREDICTION, Prediction, cholesky_solve, solve_frame

CONFIG = TrackerConfig()


@pytest.fixture(scope="module")
def frame(motion):
    seen = observe(motion.detect("simulated:2"), motion.rig, motion.person, CONFIG)
    model = kernel.make_model(motion.person, CONFIG)
    return model, seen.frame(20)


def test_cholesky_solve_against_numpy():
    rng = np.random.default_rng(0)
    A = rng.normal(size=(37, 60))
    H, b = A @ A.T, rng.normal(size=37)
    L, x = np.zeros((37, 37)), np.zeros(37)
    assert cholesky_solve(np.tril(H), 0.1, b, L, x)
    assert np.allclose(x, np.linalg.solve(H + 0.1 * np.diag(np.diag(H)), b))


@pytest.mark.parametrize("bad", [-1.0, 0.0, np.nan])
def test_cholesky_solve_refuses_what_is_not_positive(bad):
    H = np.eye(3)
    H[1, 1] = bad
    assert not cholesky_solve(H, 0.0, np.ones(3), np.zeros((3, 3)), np.zeros(3))


def test_minimum_is_that_of_a_general_optimiser(motion, frame):
    model, data = frame
    start = motion.angles[20] + 0.1
    solved, value, converged, _ = solve_frame(
        model, start, NO_PREDICTION, data, CONFIG.robust_scale, 100, 1e-9
    )
    readable = minimize(
        lambda p: energy.frame_energy(motion.person, p, data, CONFIG), solved, method="L-BFGS-B",
        options={"maxfun": 3000},
    )  # fmt: skip
    assert converged
    assert value == pytest.approx(readable.fun, abs=0.01)
    assert np.allclose(forward(motion.person, solved), motion.joints[20], atol=0.1)


def test_energy_never_rises_with_more_steps(frame):
    model, data = frame
    values = [
        solve_frame(model, np.zeros(37), NO_PREDICTION, data, CONFIG.robust_scale, n, 0.0)[1]
        for n in range(0, 12, 2)
    ]
    assert (np.diff(values) <= 0).all() and values[-1] < values[0]


def test_no_steps_do_not_count_as_converged(frame):
    model, data = frame
    start = np.full(37, 0.3)
    solved, _, converged, steps = solve_frame(
        model, start, NO_PREDICTION, data, CONFIG.robust_scale, 0, 1e-4
    )
    assert not converged and steps == 0 and np.array_equal(solved, start)


def test_prediction_holds_what_is_not_seen(frame):
    model, data = frame
    predicted = np.full(37, 0.1)
    solved, *_ = solve_frame(
        model, np.zeros(37), Prediction(predicted, np.full(37, 0.01)),
        data._replace(weights=0 * data.weights), CONFIG.robust_scale, 50, 1e-9,
    )  # fmt: skip
    assert np.allclose(solved, predicted, atol=0.01)
