"""Gradient and Gauss-Newton matrix of the log posterior of `kernel`, compiled.

numba's cache does not see changes of other files: clear `__pycache__` after editing `kernel.py`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from egocap.posterior.kernel import (
    log_prior,
    make_scratch,
    pose,
    project,
    residual,
    to_camera,
)


@njit(cache=True)
def derivatives(body, prior, optics, data, theta, expected, H, g):
    """Log posterior; its gradient into g (N,), minus its Gauss-Newton Hessian into H (N, N).

    Student-t errors enter H by their reweighted curvature, which is never negative, or, with
    `expected`, by their mean information where that is less: at the mode the residuals are smaller
    than they are among the posterior's draws, and a Gaussian by their curvature there too narrow.
    """
    H[:] = 0.0
    g[:] = 0.0
    _prior_derivatives(prior, theta, H, g)
    B = np.empty((2, 3))
    which = np.empty(37 + prior.scales + 6, np.int64)
    D = np.empty((37 + prior.scales + 6, 3))  # derivatives of X by parameters, head frame
    E = np.empty((37 + prior.scales + 6, 2))  # of the whitened residual
    scratch = make_scratch(body)
    pose(body, prior, theta, scratch)
    points, axes, R, J = scratch.points, scratch.axes, scratch.turn, scratch.J
    total = log_prior(prior, theta)
    for label in range(len(body.label_points)):
        X = points[body.label_points[label]]
        count = _point_derivatives(body, prior, points, axes, label, which, D)
        for v in range(len(optics.t)):
            weight = data.weights[v, label]
            if weight <= 0.0:
                continue
            to_camera(optics, prior, theta, v, X, scratch)
            project(optics, v, scratch)
            W, nu = data.whiten[v, label], data.degrees
            e0, e1, loss = residual(data, v, label, scratch.pixel)
            total -= loss
            pull = curve = weight
            if not np.isinf(nu):
                pull = curve = weight * (nu + 2.0) / (nu - 2.0 + (e0 * e0 + e1 * e1))
                if expected:
                    curve = min(pull, weight * (nu + 2.0) / (nu + 4.0) * nu / (nu - 2.0))
            for r in range(2):  # B = W J R_error R_camera
                for c in range(3):
                    B[r, c] = W[r, 0] * J[0, c] + W[r, 1] * J[1, c]
            n = count
            if optics.errors > 0:
                n = _rig_derivatives(prior, theta, v, scratch.turned, B, n, which, E)
                _times(B, R)
            _times(B, optics.R[v])
            for i in range(count):
                for r in range(2):
                    E[i, r] = B[r, 0] * D[i, 0] + B[r, 1] * D[i, 1] + B[r, 2] * D[i, 2]
            for i in range(n):
                g[which[i]] -= pull * (E[i, 0] * e0 + E[i, 1] * e1)
                for j in range(n):
                    H[which[i], which[j]] += curve * (E[i, 0] * E[j, 0] + E[i, 1] * E[j, 1])
    return total


@njit(cache=True)
def _times(B, R):
    """B (2, 3) becomes B R."""
    for r in range(2):
        a, b, c = B[r, 0], B[r, 1], B[r, 2]
        for k in range(3):
            B[r, k] = a * R[0, k] + b * R[1, k] + c * R[2, k]


@njit(cache=True)
def _prior_derivatives(prior, theta, H, g):
    for d in range(37):
        for e in range(37):
            g[d] -= prior.precision[d, e] * (theta[e] - prior.mean[e])
        if theta[d] > prior.limits[d, 1] or theta[d] < prior.limits[d, 0]:
            edge = prior.limits[d, 1] if theta[d] > prior.limits[d, 1] else prior.limits[d, 0]
            g[d] -= 2.0 * prior.limit_weight * (theta[d] - edge)
            H[d, d] += 2.0 * prior.limit_weight
    H[:37, :37] += prior.precision
    for i in range(len(prior.rest_precision)):
        g[37 + i] -= prior.rest_precision[i] * theta[37 + i]
        H[37 + i, 37 + i] += prior.rest_precision[i]


@njit(cache=True)
def _point_derivatives(body, prior, points, axes, label, which, D):
    """Derivatives of a label's place by angles and scales into D; returns how many there are."""
    point = body.label_points[label]
    X = points[point]
    n = 0
    while n < body.chains.shape[1] and body.chains[label, n] >= 0:
        d = body.chains[label, n]
        o, a = points[body.dof_joint[d]], axes[d]
        x, y, z = X[0] - o[0], X[1] - o[1], X[2] - o[2]
        D[n, 0] = a[1] * z - a[2] * y
        D[n, 1] = a[2] * x - a[0] * z
        D[n, 2] = a[0] * y - a[1] * x
        which[n] = d
        n += 1
    if prior.scales == 0:
        return n
    first = n
    for group in range(prior.scales):
        which[first + group] = 37 + group
        D[first + group] = 0.0
    i = point
    while i >= 0:  # up the chain: every bone adds itself to the derivative by its own scale
        parent, group = body.parents[i], body.scale_group[i]
        if group >= 0:
            for c in range(3):
                start = points[parent, c] if parent >= 0 else 0.0
                D[first + group, c] += points[i, c] - start
        i = parent
    return first + prior.scales


@njit(cache=True)
def _rig_derivatives(prior, theta, v, turned, B, n, which, E):
    """Derivatives of the whitened residual by camera v's errors into E; returns the new count.

    A turn w moves the point by (J_l dw) x turned, J_l = I + [w] / 2 + [w]^2 / 6, the left Jacobian
    of the rotation group to second order.  Source: Barfoot, State Estimation for Robotics, 7.1.
    """
    first = 37 + prior.scales + 6 * v
    w = theta[first : first + 3]
    L = np.zeros((3, 3))
    K = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    for r in range(3):
        L[r, r] = 1.0
        for c in range(3):
            L[r, c] += 0.5 * K[r, c]
            for k in range(3):
                L[r, c] += K[r, k] * K[k, c] / 6.0
    for i in range(3):
        ax, ay, az = L[0, i], L[1, i], L[2, i]
        mx = ay * turned[2] - az * turned[1]
        my = az * turned[0] - ax * turned[2]
        mz = ax * turned[1] - ay * turned[0]
        which[n + i], which[n + 3 + i] = first + i, first + 3 + i
        for r in range(2):
            E[n + i, r] = B[r, 0] * mx + B[r, 1] * my + B[r, 2] * mz
            E[n + 3 + i, r] = B[r, i]
    return n + 6
