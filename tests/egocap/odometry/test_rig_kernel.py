"""The joint normal equations are J^T W J of all residuals by all unknowns."""

import numpy as np

from egocap.odometry.rig_kernel import joint_equations

FRAMES, POINTS, OF_RIG, SEEN = 3, 4, 5, 30


def test_the_equations_are_those_of_the_dense_derivatives():
    rng = np.random.default_rng(0)
    r, weight = rng.normal(size=(SEEN, 2)), rng.uniform(0.1, 1.0, SEEN)
    own, by_point = rng.normal(size=(SEEN, 2, 6 + OF_RIG)), rng.normal(size=(SEEN, 2, 3))
    frame, point = rng.integers(FRAMES, size=SEEN), rng.integers(POINTS, size=SEEN)
    size = 6 * FRAMES + OF_RIG
    J = np.zeros((SEEN, 2, size + 3 * POINTS))
    for i in range(SEEN):
        J[i, :, 6 * frame[i] : 6 * frame[i] + 6] = own[i, :, :6]
        J[i, :, 6 * FRAMES : size] = own[i, :, 6:]
        J[i, :, size + 3 * point[i] : size + 3 * point[i] + 3] = by_point[i]
    J, w = J.reshape(2 * SEEN, -1), np.repeat(weight, 2)
    A, slope = J.T @ (w[:, None] * J), J.T @ (w * r.ravel())

    H, g, W, V, g_point = joint_equations(r, own, by_point, weight, frame, point, FRAMES, POINTS)

    np.testing.assert_allclose(H, A[:size, :size], atol=1e-12)
    np.testing.assert_allclose(W.reshape(-1, size), A[size:, :size], atol=1e-12)
    for p in range(POINTS):
        at = np.s_[size + 3 * p : size + 3 * p + 3]
        np.testing.assert_allclose(V[p], A[at, at], atol=1e-12)
    np.testing.assert_allclose(np.concatenate([g, g_point.ravel()]), slope, atol=1e-12)
