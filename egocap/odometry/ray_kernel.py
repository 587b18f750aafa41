"""Residuals of points against rays, and robust least squares over one pose (numba, float64).

A ray is a unit vector b in the head frame from the centre o of its camera. A point X of the world
has the direction u = unit(R^T (X - t) - o); the residual is u in the tangent plane of b, divided by
the standard deviation of the ray. It is defined for any angle off the optical axis.

Perturbation of a pose: R exp([w]), t + v, with the columns in the order w, v.
Source: Barfoot, State Estimation for Robotics, 2017, ch. 7; loss, Geman and McClure 1985.
"""

from __future__ import annotations

import numpy as np
from numba import njit

OPPOSITE = 1e3
"""Residual of a point that lies on the other side of the camera, in standard deviations."""


@njit(cache=True, nogil=True)
def tangents(b):
    """Two unit vectors orthogonal to the unit vector b."""
    x, y, z = abs(b[0]), abs(b[1]), abs(b[2])
    if x <= y and x <= z:
        n = 1.0 / np.sqrt(b[1] * b[1] + b[2] * b[2])
        p = (0.0, b[2] * n, -b[1] * n)
    elif y <= z:
        n = 1.0 / np.sqrt(b[2] * b[2] + b[0] * b[0])
        p = (-b[2] * n, 0.0, b[0] * n)
    else:
        n = 1.0 / np.sqrt(b[0] * b[0] + b[1] * b[1])
        p = (b[1] * n, -b[0] * n, 0.0)
    q = (b[1] * p[2] - b[2] * p[1], b[2] * p[0] - b[0] * p[2], b[0] * p[1] - b[1] * p[0])
    return p, q


@njit(cache=True, nogil=True)
def residual(R, t, X, o, b, inv_sigma, r, J_pose, J_point):
    """Residual r (2) and derivatives J_pose (2, 6), J_point (2, 3), written in place.

    Returns whether the point lies on the side of the ray.
    """
    x0, x1, x2 = X[0] - t[0], X[1] - t[1], X[2] - t[2]
    y0 = R[0, 0] * x0 + R[1, 0] * x1 + R[2, 0] * x2
    y1 = R[0, 1] * x0 + R[1, 1] * x1 + R[2, 1] * x2
    y2 = R[0, 2] * x0 + R[1, 2] * x1 + R[2, 2] * x2
    d0, d1, d2 = y0 - o[0], y1 - o[1], y2 - o[2]
    length = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
    if length < 1e-9 or d0 * b[0] + d1 * b[1] + d2 * b[2] <= 0.0:
        r[0], r[1] = OPPOSITE, OPPOSITE
        J_pose[:], J_point[:] = 0.0, 0.0
        return False
    scale = inv_sigma / length
    for a, e in enumerate(tangents(b)):
        along = (e[0] * d0 + e[1] * d1 + e[2] * d2) / length
        r[a] = along * inv_sigma
        g0 = (e[0] - along * d0 / length) * scale  # dr/dd
        g1 = (e[1] - along * d1 / length) * scale
        g2 = (e[2] - along * d2 / length) * scale
        J_pose[a, 0] = g1 * y2 - g2 * y1  # dd/dw = [y]x
        J_pose[a, 1] = g2 * y0 - g0 * y2
        J_pose[a, 2] = g0 * y1 - g1 * y0
        for i in range(3):
            J_point[a, i] = R[i, 0] * g0 + R[i, 1] * g1 + R[i, 2] * g2
            J_pose[a, 3 + i] = -J_point[a, i]
    return True


@njit(cache=True, nogil=True)
def exponential(w):
    """Rotation matrix of a rotation vector (Rodrigues)."""
    a, c = _rodrigues(np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]))
    K = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    return np.eye(3) + a * K + c * (K @ K)


@njit(cache=True, nogil=True)
def _rodrigues(angle):
    """sin x / x and (1 - cos x) / x^2 of an angle x."""
    if angle < 1e-4:
        return 1.0 - angle * angle / 6.0, 0.5 - angle * angle / 24.0
    return np.sin(angle) / angle, (1.0 - np.cos(angle)) / (angle * angle)


@njit(cache=True, nogil=True)
def logarithm(R):
    """Rotation vector of a rotation matrix that turns by less than 180 degrees."""
    w = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine2 = np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    angle = np.arctan2(sine2, R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    return w * (0.5 + angle * angle / 12.0 if angle < 1e-4 else angle / sine2)


@njit(cache=True, nogil=True)
def sights_later(centres, rays, delay, twist):
    """Centres and rays (N, 3) of a head that moved on for delay (N,) by twist (N, 6)."""
    moved, turned_rays = np.empty_like(rays), np.empty_like(rays)
    for n in range(len(rays)):
        w0, w1, w2 = delay[n] * twist[n, 0], delay[n] * twist[n, 1], delay[n] * twist[n, 2]
        a, c = _rodrigues(np.sqrt(w0 * w0 + w1 * w1 + w2 * w2))
        for out, v in ((moved[n], centres[n]), (turned_rays[n], rays[n])):
            x0, x1, x2 = w1 * v[2] - w2 * v[1], w2 * v[0] - w0 * v[2], w0 * v[1] - w1 * v[0]
            out[0] = v[0] + a * x0 + c * (w1 * x2 - w2 * x1)
            out[1] = v[1] + a * x1 + c * (w2 * x0 - w0 * x2)
            out[2] = v[2] + a * x2 + c * (w0 * x1 - w1 * x0)
        for i in range(3):
            moved[n, i] += delay[n] * twist[n, 3 + i]
    return moved, turned_rays


@njit(cache=True, nogil=True)
def turned(R, w):
    """R exp([w]), orthonormal again to rounding error (one Newton step of the polar factor).

    Without it, predictions from earlier poses multiply the rounding error in every frame.
    """
    product = np.ascontiguousarray(R) @ exponential(w)
    return 0.5 * (product @ (3.0 * np.eye(3) - product.T @ product))


@njit(cache=True, nogil=True)
def squared_residuals(R, t, X, o, b, inv_sigma):
    """Squared length of every residual (N,); points X (N, 3), centres o (N, 3), rays b (N, 3)."""
    r, J_pose, J_point = np.empty(2), np.empty((2, 6)), np.empty((2, 3))
    found = np.empty(len(X))
    for n in range(len(X)):
        residual(R, t, X[n], o[n], b[n], inv_sigma[n], r, J_pose, J_point)
        found[n] = r[0] * r[0] + r[1] * r[1]
    return found


@njit(cache=True, nogil=True)
def linearised(R, t, X, frame, point, o, b, inv_sigma):
    """Residuals (N, 2) of observations and their derivatives.

    Poses R (K, 3, 3) and t (K, 3); points X (P, 3); observation n is of `point` n by `frame` n.
    Derivatives: by the pose (N, 2, 6), by the point (N, 2, 3), by the centre o (N, 2, 3) and by the
    ray b (N, 2, 3), the last for small residuals.
    """
    N = len(frame)
    r, J_pose, J_point = np.empty((N, 2)), np.empty((N, 2, 6)), np.empty((N, 2, 3))
    J_centre, J_ray = np.empty((N, 2, 3)), np.empty((N, 2, 3))
    for n in range(N):
        k = frame[n]
        residual(R[k], t[k], X[point[n]], o[n], b[n], inv_sigma[n], r[n], J_pose[n], J_point[n])
        for a, e in enumerate(tangents(b[n])):
            for i in range(3):
                J_ray[n, a, i] = -inv_sigma[n] * e[i]
                # J_point = g R^T, and the centre is subtracted from R^T (X - t).
                J_centre[n, a, i] = -(
                    J_point[n, a, 0] * R[k, 0, i] + J_point[n, a, 1] * R[k, 1, i]
                    + J_point[n, a, 2] * R[k, 2, i]
                )  # fmt: skip
    return r, J_pose, J_point, J_centre, J_ray


@njit(cache=True, nogil=True)
def normal_equations(R, t, X, o, b, inv_sigma, width):
    """J^T W J (6, 6), J^T W r (6) and the robust cost at a pose; `width` of the loss in sigmas."""
    r, J, J_point = np.empty(2), np.empty((2, 6)), np.empty((2, 3))
    H, g, cost = np.zeros((6, 6)), np.zeros(6), 0.0
    c2 = width * width
    for n in range(len(X)):
        ahead = residual(R, t, X[n], o[n], b[n], inv_sigma[n], r, J, J_point)
        e2 = r[0] * r[0] + r[1] * r[1]
        cost += c2 * e2 / (c2 + e2)
        if not ahead:
            continue
        weight = (c2 / (c2 + e2)) ** 2
        for i in range(6):
            g[i] += weight * (J[0, i] * r[0] + J[1, i] * r[1])
            for j in range(i, 6):
                H[i, j] += weight * (J[0, i] * J[0, j] + J[1, i] * J[1, j])
    for i in range(6):
        for j in range(i):
            H[i, j] = H[j, i]
    return H, g, cost


@njit(cache=True, nogil=True)
def refine_pose(R, t, X, o, b, inv_sigma, widths, rounds):
    """Gauss-Newton steps on one pose with a loss that narrows; returns R, t and J^T W J there.

    `widths` are the loss's successive widths in sigmas, `rounds` the most steps at each.
    """
    H = np.eye(6)
    for width in widths:
        for _ in range(rounds):
            H, g, _ = normal_equations(R, t, X, o, b, inv_sigma, width)
            damped = H.copy()
            for i in range(6):
                damped[i, i] += 1e-9 * H[i, i] + 1e-12
            step = np.linalg.solve(damped, -g)
            R = turned(R, step[:3])
            t = t + step[3:]
            if np.abs(step).max() < 1e-7:
                break
    return R, t, H
