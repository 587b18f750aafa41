"""Log posterior of many parameter vectors, compiled; its derivatives are in `curvature`.

Densities are in the pixels of the detections, so that those drawn by `synthetic_pose` follow them
exactly. A test compares them with the readable form in `egocap.posterior.log_prob` and with finite
differences. numba's cache does not see changes of other files: clear `__pycache__` after editing
`egocap.body.kinematics`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numba import njit, prange
from numpy import ndarray as Array

from egocap.body.kinematics import KinematicTree, forward_kinematics

BLOCK = 8
"""Vectors that a thread evaluates with one working memory."""
LEAF: dict[str, Any] = {"cache": True, "_nrt": False}
"""Functions that allocate nothing: without reference counts, for which threads would compete."""


class Prior(NamedTuple):
    """The prior. Parameters: 37 angles, S scales, E rig errors."""

    limits: Float[Array, "37 2"]
    limit_weight: float
    mean: Float[Array, "37"]
    precision: Float[Array, "37 37"]
    scales: int
    rest_precision: Float[Array, "N"]  # of the parameters after the angles, which centre on 0


class Body(NamedTuple):
    """The skeleton, and which parameters move which label.

    Repeats the fields of `KinematicTree`: numba hands nested tuples to no parallel loop.
    """

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


class Scratch(NamedTuple):
    """Working memory: a posed skeleton, and a point on its way to a pixel."""

    offsets: Float[Array, "22 3"]
    points: Float[Array, "22 3"]
    axes: Float[Array, "37 3"]
    R: Float[Array, "17 3 3"]
    turn: Float[Array, "3 3"]  # of a camera's rig error
    turned: Float[Array, "3"]  # point turned by it, before the camera's shift
    x: Float[Array, "3"]  # point in the camera's frame
    pixel: Float[Array, "2"]
    J: Float[Array, "2 3"]  # pixel by x


@njit(cache=True)
def make_scratch(body):
    """Working memory for one thread."""
    points, joints = len(body.parents), len(body.first_dof) - 1
    return Scratch(
        np.empty((points, 3)), np.empty((points, 3)), np.empty((len(body.axes), 3)),
        np.empty((joints, 3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(2),
        np.empty((2, 3)),
    )  # fmt: skip


@njit(**LEAF)
def pose(body, prior, theta, scratch):
    """Pose a skeleton, into the scratch, with its bones scaled by theta."""
    offsets = scratch.offsets
    for i in range(len(offsets)):
        group = body.scale_group[i] if prior.scales > 0 else -1
        factor = np.exp(theta[37 + group]) if group >= 0 else 1.0
        for c in range(3):
            offsets[i, c] = factor * body.offsets[i, c]
    tree = KinematicTree(offsets, body.parents, body.axes, body.first_dof)
    forward_kinematics(tree, theta[:37], scratch.points, scratch.axes, scratch.R)


@njit(**LEAF)
def project(optics, v, scratch):
    """Pixel of the point x in camera v's frame, and its derivative J."""
    x, pixel, J = scratch.x, scratch.pixel, scratch.J
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


@njit(**LEAF)
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


@njit(**LEAF)
def to_camera(optics, prior, theta, v, X, scratch):
    """Transform a point X (3,) of the head frame to camera v's frame."""
    x, R, turned = scratch.x, scratch.turn, scratch.turned
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


@njit(**LEAF)
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


@njit(**LEAF)
def residual(data, v, label, pixel):
    """Whitened residual of a projected label, and its weighted loss."""
    a, b = pixel[0] - data.pixels[v, label, 0], pixel[1] - data.pixels[v, label, 1]
    W, weight = data.whiten[v, label], data.weights[v, label]
    e0, e1 = W[0, 0] * a + W[0, 1] * b, W[1, 0] * a + W[1, 1] * b
    squared = e0 * e0 + e1 * e1
    if np.isinf(data.degrees):
        return e0, e1, 0.5 * weight * squared
    nu = data.degrees
    return e0, e1, 0.5 * weight * (nu + 2.0) * np.log1p(squared / (nu - 2.0))


@njit(**LEAF)
def _log_likelihood(body, prior, optics, data, theta, scratch):
    """Log likelihood of one parameter vector, up to a constant."""
    pose(body, prior, theta, scratch)
    total = 0.0
    for v in range(len(optics.t)):
        for label in range(len(body.label_points)):
            if data.weights[v, label] <= 0.0:
                continue
            X = scratch.points[body.label_points[label]]
            to_camera(optics, prior, theta, v, X, scratch)
            project(optics, v, scratch)
            total -= residual(data, v, label, scratch.pixel)[2]
    return total


@njit(cache=True, parallel=True)
def log_probs(body, prior, optics, data, thetas, out):
    """Log posterior of vectors (W, N) into out (W,)."""
    for block in prange(-(-len(thetas) // BLOCK)):
        scratch = make_scratch(body)
        for w in range(block * BLOCK, min((block + 1) * BLOCK, len(thetas))):
            likelihood = _log_likelihood(body, prior, optics, data, thetas[w], scratch)
            out[w] = log_prior(prior, thetas[w]) + likelihood


@njit(cache=True)
def joints(body, prior, thetas, out):
    """Labelled joints (W, 18, 3), head frame, metres, of parameter vectors (W, N)."""
    scratch = make_scratch(body)
    for w in range(len(thetas)):
        pose(body, prior, thetas[w], scratch)
        for label in range(len(body.label_points)):
            out[w, label] = scratch.points[body.label_points[label]]
