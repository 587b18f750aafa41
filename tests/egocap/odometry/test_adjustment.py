"""Bundle adjustment on rays of a known scene."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from egocap.odometry.adjustment import Problem, adjust
from egocap.odometry.ray_kernel import exponential, squared_residuals

CENTRES = np.array([[0.37, 0.175, 0.14], [0.37, -0.175, 0.14]])


def problem(rng, keyframes=6, points=80, noise=0.0, fixed=1):
    """A walk past points that both cameras see; exact poses and points with it."""
    R = Rotation.from_rotvec(0.1 * rng.normal(size=(keyframes, 3))).as_matrix()
    t = np.stack([0.2 * np.arange(keyframes), np.zeros(keyframes), np.zeros(keyframes)], -1)
    X = rng.uniform([-2, -2, -1.8], [3, 2, -0.5], size=(points, 3))
    frame = np.tile(np.repeat(np.arange(keyframes), 2), points)
    view = np.tile([0, 1], keyframes * points)
    point = np.repeat(np.arange(points), 2 * keyframes)
    d = np.einsum("nij,ni->nj", R[frame], X[point] - t[frame]) - CENTRES[view]
    b = d / np.linalg.norm(d, axis=1, keepdims=True) + noise * rng.normal(size=d.shape)
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    start = np.arange(points + 1) * 2 * keyframes
    held = np.arange(keyframes) < fixed
    inv_sigma = np.full(len(frame), 800.0)
    return Problem(R, t, X, start, frame, CENTRES[view], b, inv_sigma, held)


def disturbed(rng, exact, turn=0.01, move=0.02, point=0.05):
    free = ~exact.fixed
    R, t = exact.R.copy(), exact.t.copy()
    for k in np.flatnonzero(free):
        R[k] = R[k] @ exponential(turn * rng.normal(size=3))
        t[k] += move * rng.normal(size=3)
    X = exact.points + point * rng.normal(size=exact.points.shape)
    return Problem(
        R,
        t,
        X,
        *[getattr(exact, n) for n in ("start", "frame", "origin", "ray", "inv_sigma", "fixed")],
    )


def test_exact_rays_give_exact_poses_and_points(rng):
    exact = problem(rng)
    found = adjust(disturbed(rng, exact), 50.0, 20)
    assert found.cost < 1e-8
    assert found.t == pytest.approx(exact.t, abs=1e-6)
    assert pytest.approx(exact.R, abs=1e-6) == found.R
    assert found.points == pytest.approx(exact.points, abs=1e-5)


def test_stereo_fixes_the_scale_though_one_keyframe_is_held(rng):
    exact = problem(rng)
    shrunk = Problem(exact.R, 0.9 * exact.t, 0.9 * exact.points, exact.start, exact.frame,
                     exact.origin, exact.ray, exact.inv_sigma, exact.fixed)  # fmt: skip
    found = adjust(shrunk, 1000.0, 30)
    assert found.t == pytest.approx(exact.t, abs=1e-5)


def test_fixed_keyframes_stay(rng):
    start = disturbed(rng, problem(rng, fixed=3))
    found = adjust(start, 50.0, 5)
    assert (found.R[:3] == start.R[:3]).all()
    assert (found.t[:3] == start.t[:3]).all()


def test_outliers_are_ignored(rng):
    exact = problem(rng)
    exact.ray[::17] = rng.normal(size=exact.ray[::17].shape)
    exact.ray[::17] /= np.linalg.norm(exact.ray[::17], axis=1, keepdims=True)
    found = adjust(disturbed(rng, exact, 0.002, 0.005, 0.01), 10.0, 30)
    assert found.t == pytest.approx(exact.t, abs=1e-5)


def test_sparse_and_dense_systems_agree(rng, monkeypatch):
    start = disturbed(rng, problem(rng, keyframes=9, points=30, noise=1e-3))
    dense = adjust(start, 50.0, 4)
    monkeypatch.setattr("egocap.odometry.adjustment._DENSE", 0)
    sparse = adjust(start, 50.0, 4)
    assert sparse.t == pytest.approx(dense.t, abs=1e-9)
    assert sparse.points == pytest.approx(dense.points, abs=1e-8)


def test_reduced_system_is_the_inverse_covariance_of_the_keyframes(rng):
    """The blocks that the Schur complement leaves equal those of the full normal matrix."""
    exact = problem(rng, keyframes=3, points=12)
    found = adjust(exact, 1e6, 0, system=True)
    residuals = []
    h = 1e-6
    columns = [(k, i) for k in (1, 2) for i in range(6)] + [
        (p, i) for p in range(12) for i in range(3)
    ]
    for n, (which, i) in enumerate(columns):
        ends = []
        for sign in (1, -1):
            R, t, X = exact.R.copy(), exact.t.copy(), exact.points.copy()
            step = sign * h * np.eye(6)[i]
            if n < 12:
                R[which], t[which] = R[which] @ exponential(step[:3]), t[which] + step[3:]
            else:
                X[which] += step[:3]
            ends.append(_residuals(exact, R, t, X))
        residuals.append((ends[0] - ends[1]) / (2 * h))
    J = np.stack(residuals, -1)
    covariance = np.linalg.inv(J.T @ J)[:12, :12]
    assert np.linalg.inv(found.system.toarray()) == pytest.approx(covariance, rel=1e-3, abs=1e-9)


def _residuals(p, R, t, X):
    from egocap.odometry.ray_kernel import residual

    r, Jc, Jp, out = np.empty(2), np.empty((2, 6)), np.empty((2, 3)), []
    for point in range(len(X)):
        for n in range(p.start[point], p.start[point + 1]):
            k = p.frame[n]
            residual(R[k], t[k], X[point], p.origin[n], p.ray[n], p.inv_sigma[n], r, Jc, Jp)
            out.extend(r)
    return np.array(out)


def test_points_of_noisy_rays_fit_to_their_noise(rng):
    start = problem(rng, keyframes=8, points=100, noise=1.0 / 800.0)
    found = adjust(start, 50.0, 20)
    point = np.repeat(np.arange(100), 16)
    e2 = np.concatenate([
        squared_residuals(found.R[k], found.t[k], found.points[point[start.frame == k]],
                          start.origin[start.frame == k], start.ray[start.frame == k],
                          start.inv_sigma[start.frame == k]) for k in range(8)])  # fmt: skip
    free = 2 * len(point) - 3 * 100 - 6 * 7
    assert e2.sum() / free == pytest.approx(1.0, abs=0.12)
