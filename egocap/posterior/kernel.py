"""Log posterior, its gradient and its Gauss-Newton matrix for many parameter vectors, compiled.

Densities are in the pixels of the detections, so that what `simulation` draws follows them to the
letter. A test compares them with the readable form in `egocap.posterior.log_prob` and with finite
differences. Forward kinematics is the tracker's compiled chain; numba's cache does not see changes
of other files: clear `__pycache__` after editing `egocap/track/kernel.py`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numba import njit, prange
from numpy import ndarray as Array

from egocap.track.kernel import chain


class Skeleton(NamedTuple):
    """What the chain needs, with the bones at their inferred lengths. (numba hands nested tuples to
    no parallel loop, so `Body` repeats these fields.)"""

    offsets: Float[Array, "22 3"]
    parents: Int[Array, "22"]
    axes: Float[Array, "37 3"]
    first_dof: Int[Array, "18"]


class Prior(NamedTuple):
    """Beliefs without the detections. Parameters: 37 angles, S scales, E rig errors."""

    limits: Float[Array, "37 2"]
    limit_weight: float
    mean: Float[Array, "37"]
    precision: Float[Array, "37 37"]
    scales: int
    rest_precision: Float[Array, "N"]  # of the parameters after the angles, which centre on 0


class Body(NamedTuple):
    """The skeleton as stated, and which parameters move which label."""

    offsets: Float[Array, "22 3"]
    parents: Int[Array, "22"]
    axes: Float[Array, "37 3"]
    first_dof: Int[Array, "18"]  # of each joint, and the total at the end
    dof_joint: Int[Array, "37"]
    label_points: Int[Array, "18"]
    chains: Int[Array, "18 D"]  # the angles that move each label, -1 after the last
    scale_group: Int[Array, "22"]  # -1: never scaled


class Optics(NamedTuple):
    """Cameras: points of the head frame into pixels."""

    R: Float[Array, "V 3 3"]
    t: Float[Array, "V 3"]
    coefficients: Float[Array, "V C"]  # of r(theta) / theta, padded with zeros
    middle: Float[Array, "V"]
    half: Float[Array, "V"]
    limit: Float[Array, "V"]
    affine: Float[Array, "V 2 2"]
    centre: Float[Array, "V 2"]
    errors: int  # rig errors a view: 0 or 6


class Data(NamedTuple):
    """One frame's detections."""

    pixels: Float[Array, "V 18 2"]
    whiten: Float[Array, "V 18 2 2"]  # pixels off -> standard deviations
    weights: Float[Array, "V 18"]  # 0: missing; else 1 / temperature
    degrees: float  # inf: Gaussian


@njit(cache=True)
def project(optics, v, x, J, pixel):
    """Pixel (2,) of a point (3,) in camera v's frame and its derivative J (2, 3); both output."""
    rho = max(np.sqrt(x[0] * x[0] + x[1] * x[1]), 1e-15)
    theta = np.arctan2(rho, x[2])
    inner = min(theta, optics.limit[v])
    s = (inner - optics.middle[v]) / optics.half[v]
    q, dq = 0.0, 0.0
    for k in range(optics.coefficients.shape[1] - 1, -1, -1):
        dq = dq * s + q
        q = q * s + optics.coefficients[v, k]
    slope = q + inner * dq / optics.half[v]
    radius = inner * q + slope * (theta - inner)
    m = radius / rho
    dx, dy = x[0] / rho, x[1] / rho
    d2 = rho * rho + x[2] * x[2]
    bend = slope * x[2] / d2 - m
    sink = -slope * rho / d2
    A = optics.affine[v]
    for r in range(2):
        a, b = A[r, 0], A[r, 1]
        pixel[r] = a * x[0] * m + b * x[1] * m + optics.centre[v, r]
        J[r, 0] = a * (m + dx * dx * bend) + b * dx * dy * bend
        J[r, 1] = a * dx * dy * bend + b * (m + dy * dy * bend)
        J[r, 2] = (a * dx + b * dy) * sink


@njit(cache=True)
def _turn(w, R):
    """Rotation matrix R (3, 3), output, of a rotation vector w (3,)."""
    angle2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    angle = np.sqrt(angle2)
    a = 1.0 - angle2 / 6.0 if angle < 1e-4 else np.sin(angle) / angle
    b = 0.5 - angle2 / 24.0 if angle < 1e-4 else (1.0 - np.cos(angle)) / angle2
    for r in range(3):
        for c in range(3):
            R[r, c] = b * w[r] * w[c]
        R[r, r] += 1.0 - b * angle2
    R[0, 1] -= a * w[2]
    R[0, 2] += a * w[1]
    R[1, 0] += a * w[2]
    R[1, 2] -= a * w[0]
    R[2, 0] -= a * w[1]
    R[2, 1] += a * w[0]


@njit(cache=True)
def _scaled(body, prior, theta, offsets):
    """The skeleton with its bones at the lengths that theta says; offsets (22, 3) is scratch."""
    offsets[:] = body.offsets
    if prior.scales > 0:
        for i in range(len(offsets)):
            group = body.scale_group[i]
            if group >= 0:
                factor = np.exp(theta[37 + group])
                for c in range(3):
                    offsets[i, c] *= factor
    return Skeleton(offsets, body.parents, body.axes, body.first_dof)


@njit(cache=True)
def _to_camera(optics, prior, theta, v, X, R, turned, x):
    """Point x (3,), output, in camera v's frame; `turned` (3,) is it before the camera's shift."""
    for r in range(3):
        x[r] = optics.t[v, r]
        for c in range(3):
            x[r] += optics.R[v, r, c] * X[c]
    if optics.errors > 0:
        first = 37 + prior.scales + 6 * v
        _turn(theta[first : first + 3], R)
        for r in range(3):
            turned[r] = R[r, 0] * x[0] + R[r, 1] * x[1] + R[r, 2] * x[2]
        for r in range(3):
            x[r] = turned[r] + theta[first + 3 + r]


@njit(cache=True)
def log_prior(prior, theta):
    """Log prior density of one parameter vector, up to a constant."""
    total = 0.0
    for d in range(37):
        over = theta[d] - prior.limits[d, 1]
        under = prior.limits[d, 0] - theta[d]
        beyond = max(over, under, 0.0)
        total -= prior.limit_weight * beyond * beyond
        pull = 0.5 * prior.precision[d, d] * (theta[d] - prior.mean[d])
        for e in range(d):
            pull += prior.precision[d, e] * (theta[e] - prior.mean[e])
        total -= pull * (theta[d] - prior.mean[d])
    for i in range(len(prior.rest_precision)):
        total -= 0.5 * prior.rest_precision[i] * theta[37 + i] ** 2
    return total


@njit(cache=True)
def log_likelihood(body, prior, optics, data, theta):
    """Log likelihood of one parameter vector, up to a constant."""
    points, axes, offsets = np.empty((22, 3)), np.empty((37, 3)), np.empty((22, 3))
    R, J = np.empty((3, 3)), np.empty((2, 3))
    x, turned, pixel = np.empty(3), np.empty(3), np.empty(2)
    chain(_scaled(body, prior, theta, offsets), theta[:37], points, axes)
    total = 0.0
    for v in range(len(optics.t)):
        for label in range(len(body.label_points)):
            weight = data.weights[v, label]
            if weight <= 0.0:
                continue
            _to_camera(optics, prior, theta, v, points[body.label_points[label]], R, turned, x)
            project(optics, v, x, J, pixel)
            a, b = pixel[0] - data.pixels[v, label, 0], pixel[1] - data.pixels[v, label, 1]
            W = data.whiten[v, label]
            e0, e1 = W[0, 0] * a + W[0, 1] * b, W[1, 0] * a + W[1, 1] * b
            squared = e0 * e0 + e1 * e1
            if np.isinf(data.degrees):
                total -= 0.5 * weight * squared
            else:
                nu = data.degrees
                total -= 0.5 * weight * (nu + 2.0) * np.log1p(squared / (nu - 2.0))
    return total


@njit(cache=True, parallel=True)
def log_probs(body, prior, optics, data, thetas, out):
    """Log posterior of vectors (W, N) into out (W,)."""
    for w in prange(len(thetas)):
        out[w] = log_prior(prior, thetas[w]) + log_likelihood(body, prior, optics, data, thetas[w])


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
    points, axes, offsets = np.empty((22, 3)), np.empty((37, 3)), np.empty((22, 3))
    R, J, B = np.empty((3, 3)), np.empty((2, 3)), np.empty((2, 3))
    x, turned, pixel = np.empty(3), np.empty(3), np.empty(2)
    which = np.empty(37 + prior.scales + 6, np.int64)
    D = np.empty((37 + prior.scales + 6, 3))  # derivatives of X by parameters, head frame
    E = np.empty((37 + prior.scales + 6, 2))  # of the whitened residual
    chain(_scaled(body, prior, theta, offsets), theta[:37], points, axes)
    total = log_prior(prior, theta)
    for label in range(len(body.label_points)):
        point = body.label_points[label]
        X = points[point]
        count = _point_derivatives(body, prior, points, axes, label, which, D)
        for v in range(len(optics.t)):
            weight = data.weights[v, label]
            if weight <= 0.0:
                continue
            _to_camera(optics, prior, theta, v, X, R, turned, x)
            project(optics, v, x, J, pixel)
            a, b = pixel[0] - data.pixels[v, label, 0], pixel[1] - data.pixels[v, label, 1]
            W = data.whiten[v, label]
            e0, e1 = W[0, 0] * a + W[0, 1] * b, W[1, 0] * a + W[1, 1] * b
            squared = e0 * e0 + e1 * e1
            pull = weight
            if np.isinf(data.degrees):
                total -= 0.5 * weight * squared
            else:
                nu = data.degrees
                total -= 0.5 * weight * (nu + 2.0) * np.log1p(squared / (nu - 2.0))
                pull = weight * (nu + 2.0) / (nu - 2.0 + squared)
            curve = pull
            if expected and not np.isinf(data.degrees):
                nu = data.degrees
                curve = min(pull, weight * (nu + 2.0) / (nu + 4.0) * nu / (nu - 2.0))
            for r in range(2):  # B = W J R_error R_camera
                for c in range(3):
                    B[r, c] = W[r, 0] * J[0, c] + W[r, 1] * J[1, c]
            n = count
            if optics.errors > 0:
                n = _rig_derivatives(prior, theta, v, turned, B, n, which, E)
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


@njit(cache=True)
def joints(body, prior, thetas, out):
    """Labelled joints (W, 18, 3), head frame, metres, of parameter vectors (W, N)."""
    points, axes, offsets = np.empty((22, 3)), np.empty((37, 3)), np.empty((22, 3))
    for w in range(len(thetas)):
        chain(_scaled(body, prior, thetas[w], offsets), thetas[w, :37], points, axes)
        for label in range(len(body.label_points)):
            out[w, label] = points[body.label_points[label]]
