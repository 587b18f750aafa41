"""Gradient of the log posterior, and leapfrog trajectories of many walkers, compiled.

Forces at the joints are summed over the views and carried down the kinematic chains, so that a
gradient costs about twice the density. `curvature` has the same gradient with its Gauss-Newton
matrix; a test compares them.

Source: Neal 2011, "MCMC using Hamiltonian dynamics", Handbook of Markov Chain Monte Carlo, ch. 5.
numba's cache does not see changes of other files: clear `__pycache__` after editing `kernel.py`.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from egocap.posterior.kernel import LEAF, make_scratch, pose, project, residual, to_camera

BLOCK = 4
"""Walkers that a thread moves with one working memory."""


@njit(**LEAF)
def gradient(body, prior, optics, data, theta, scratch, force, g):
    """Gradient of the log posterior at theta into g (N,); `force` (2, 3) is working memory."""
    _prior_gradient(prior, theta, g)
    pose(body, prior, theta, scratch)
    for label in range(len(body.label_points)):
        _label_force(body, prior, optics, data, theta, label, scratch, force, g)
        _pull_chain(body, prior, label, scratch, force, g)


@njit(**LEAF)
def _prior_gradient(prior, theta, g):
    for d in range(37):
        total = 0.0
        for e in range(37):
            total -= prior.precision[d, e] * (theta[e] - prior.mean[e])
        over = max(theta[d] - prior.limits[d, 1], 0.0) + min(theta[d] - prior.limits[d, 0], 0.0)
        g[d] = total - 2.0 * prior.limit_weight * over
    for i in range(len(prior.rest_precision)):
        g[37 + i] = -prior.rest_precision[i] * theta[37 + i]


@njit(**LEAF)
def _label_force(body, prior, optics, data, theta, label, scratch, force, g):
    """Gradient by a label's place into force[0], head frame; by the rig's errors, added to g."""
    X = scratch.points[body.label_points[label]]
    total, q = force[0], force[1]
    J = scratch.J
    total[:] = 0.0
    nu = data.degrees
    for v in range(len(optics.t)):
        weight = data.weights[v, label]
        if weight <= 0.0:
            continue
        to_camera(optics, prior, theta, v, X, scratch)
        project(optics, v, scratch)
        W = data.whiten[v, label]
        e0, e1, _ = residual(data, v, label, scratch.pixel)
        pull = weight
        if not np.isinf(nu):
            pull *= (nu + 2.0) / (nu - 2.0 + (e0 * e0 + e1 * e1))
        a, b = pull * (W[0, 0] * e0 + W[1, 0] * e1), pull * (W[0, 1] * e0 + W[1, 1] * e1)
        for c in range(3):
            q[c] = -(J[0, c] * a + J[1, c] * b)
        if optics.errors > 0:
            _rig_gradient(prior, theta, v, scratch, q, g)
        for c in range(3):
            for r in range(3):
                total[c] += optics.R[v, r, c] * q[r]


@njit(**LEAF)
def _rig_gradient(prior, theta, v, scratch, q, g):
    """Camera v's part of the gradient from the gradient q by the point in its frame; q becomes that
    by the point before the rig's errors.

    By the turn w it is J_l^T (turned x q), J_l as in `curvature`.
    """
    first = 37 + prior.scales + 6 * v
    w, x, R = theta[first : first + 3], scratch.turned, scratch.turn
    c0, c1, c2 = x[1] * q[2] - x[2] * q[1], x[2] * q[0] - x[0] * q[2], x[0] * q[1] - x[1] * q[0]
    d0, d1, d2 = w[1] * c2 - w[2] * c1, w[2] * c0 - w[0] * c2, w[0] * c1 - w[1] * c0
    g[first] += c0 - 0.5 * d0 + (w[1] * d2 - w[2] * d1) / 6.0
    g[first + 1] += c1 - 0.5 * d1 + (w[2] * d0 - w[0] * d2) / 6.0
    g[first + 2] += c2 - 0.5 * d2 + (w[0] * d1 - w[1] * d0) / 6.0
    for i in range(3):
        g[first + 3 + i] += q[i]
    q0, q1, q2 = q[0], q[1], q[2]
    for c in range(3):
        q[c] = R[0, c] * q0 + R[1, c] * q1 + R[2, c] * q2


@njit(**LEAF)
def _pull_chain(body, prior, label, scratch, force, g):
    """Add the gradient by the angles and scales that move a label, from that by its place."""
    points, axes, f = scratch.points, scratch.axes, force[0]
    i = body.label_points[label]
    X = points[i]
    n = 0
    while n < body.chains.shape[1] and body.chains[label, n] >= 0:
        d = body.chains[label, n]
        o, a = points[body.dof_joint[d]], axes[d]
        x, y, z = X[0] - o[0], X[1] - o[1], X[2] - o[2]
        g[d] += f[0] * (a[1] * z - a[2] * y)
        g[d] += f[1] * (a[2] * x - a[0] * z)
        g[d] += f[2] * (a[0] * y - a[1] * x)
        n += 1
    while prior.scales > 0 and i >= 0:
        parent, group = body.parents[i], body.scale_group[i]
        if group >= 0:
            for c in range(3):
                start = points[parent, c] if parent >= 0 else 0.0
                g[37 + group] += f[c] * (points[i, c] - start)
        i = parent


@njit(cache=True)
def gradients(body, prior, optics, data, thetas, out):
    """Gradients of the log posterior at vectors (W, N) into out (W, N)."""
    scratch, force = make_scratch(body), np.empty((2, 3))
    for w in range(len(thetas)):
        gradient(body, prior, optics, data, thetas[w], scratch, force, out[w])


@njit(**LEAF)
def _kick(root, size, g, p):
    """p += size root^T g, `root` lower triangular."""
    for i in range(len(p)):
        total = 0.0
        for j in range(i, len(p)):
            total += root[j, i] * g[j]
        p[i] += size * total


@njit(**LEAF)
def _drift(root, size, p, theta):
    """theta += size root p."""
    for i in range(len(p)):
        total = 0.0
        for j in range(i + 1):
            total += root[i, j] * p[j]
        theta[i] += size * total


@njit(cache=True, parallel=True)
def leapfrog(body, prior, optics, data, roots, which, sizes, steps, thetas, momenta):
    """Trajectories of walkers; thetas (W, N) and momenta (W, N) become those at the ends.

    `roots` (K, N, N) are Cholesky factors of covariances, of which a walker uses number `which`
    (W,): it moves in the coordinates in which that covariance is the identity. `sizes` (W,) and
    `steps` (W,) are each walker's step and number of steps.
    """
    for block in prange(-(-len(thetas) // BLOCK)):
        scratch, force = make_scratch(body), np.empty((2, 3))
        g = np.empty(thetas.shape[1])
        for w in range(block * BLOCK, min((block + 1) * BLOCK, len(thetas))):
            root, theta, p, size = roots[which[w]], thetas[w], momenta[w], sizes[w]
            gradient(body, prior, optics, data, theta, scratch, force, g)
            _kick(root, 0.5 * size, g, p)
            for step in range(steps[w]):
                _drift(root, size, p, theta)
                gradient(body, prior, optics, data, theta, scratch, force, g)
                _kick(root, size if step + 1 < steps[w] else 0.5 * size, g, p)
