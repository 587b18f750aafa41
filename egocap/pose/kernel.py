"""The energy of `egocap.pose.energy` with its gradient and Gauss-Newton matrix, compiled.

One call handles one frame in a few tens of microseconds, in double precision. Compiled code is
cached on disk, so everything that may change (the skeleton's tables, the settings) is an argument.

Source: iteratively reweighted Gauss-Newton; Triggs et al. 2000, "Bundle adjustment - a modern
synthesis", section 3.3 and 4.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numba import njit
from numpy import ndarray as Array

from egocap.body.kinematics import LABEL_CHAINS, kinematic_tree, pose_skeleton
from egocap.body.proportions import Proportions
from egocap.body.skeleton import LIMITS, SPREAD
from egocap.pose.config import TrackerConfig
from egocap.pose.observations import OPPOSITE, Rays
from egocap.pose.pose_prior import load_posture


class Model(NamedTuple):
    """The skeleton and the settings as plain arrays."""

    offsets: Float[Array, "22 3"]
    parents: Int[Array, "22"]
    axes: Float[Array, "37 3"]
    first_dof: Int[Array, "18"]  # of each joint, and the total at the end
    dof_joint: Int[Array, "37"]
    label_points: Int[Array, "18"]
    chains: Int[Array, "18 D"]  # the angles that move each label, -1 after the last
    limits: Float[Array, "37 2"]
    spread: Float[Array, "37"]
    lambda_limit: float
    lambda_pose: float
    lambda_smooth: float
    posture_mean: Float[Array, "37"]
    posture_precision: Float[Array, "37 37"]  # times its weight


def make_model(proportions: Proportions, config: TrackerConfig) -> Model:
    """Gather what the kernels need."""
    posture, labels = load_posture(), LABEL_CHAINS
    return Model(
        *kinematic_tree(proportions), labels.dof_joint, labels.points, labels.chains,
        LIMITS, SPREAD,
        float(config.lambda_limit), float(config.lambda_pose), float(config.lambda_smooth),
        posture.mean, config.lambda_posture * posture.precision,
    )  # fmt: skip


@njit(cache=True, nogil=True)
def detections(model, angles, seen, scale, H, g):
    """Add the detection term's Gauss-Newton matrix and gradient to H (37,37), g (37,).

    `seen` are the `Rays` of one frame. H gets its lower triangle only. Returns the energy.
    """
    centres, rays, whiten, weights = seen
    points, axes = pose_skeleton(model, angles)
    scale2 = scale * scale
    energy = 0.0
    B = np.empty((2, 3))
    P = np.empty((3, 3))  # sum of w B^T B: information about the joint's position
    q = np.empty(3)
    J = np.empty((model.chains.shape[1], 3))
    PJ = np.empty((model.chains.shape[1], 3))
    for label in range(len(model.label_points)):
        X = points[model.label_points[label]]
        P[:] = 0.0
        q[:] = 0.0
        found = False
        for v in range(len(centres)):
            weight = weights[v, label]
            if weight <= 0.0:
                continue
            found = True
            ray, W = rays[v, label], whiten[v, label]
            dx, dy, dz = X[0] - centres[v, 0], X[1] - centres[v, 1], X[2] - centres[v, 2]
            distance = max(np.sqrt(dx * dx + dy * dy + dz * dz), OPPOSITE)
            dx, dy, dz = dx / distance, dy / distance, dz / distance
            towards = 1.0 + ray[0] * dx + ray[1] * dy + ray[2] * dz
            # There the residual has no limit, and its loss is at the largest.
            if towards <= OPPOSITE or distance <= OPPOSITE:
                energy += 0.5 * weight * scale2
                continue
            e0 = 2.0 * (W[0, 0] * dx + W[0, 1] * dy + W[0, 2] * dz) / towards
            e1 = 2.0 * (W[1, 0] * dx + W[1, 1] * dy + W[1, 2] * dz) / towards
            squared = e0 * e0 + e1 * e1
            share = scale2 / (squared + scale2)
            energy += 0.5 * weight * squared * share
            w = weight * share * share
            for c in range(3):
                B[0, c] = (2.0 * W[0, c] - e0 * ray[c]) / towards
                B[1, c] = (2.0 * W[1, c] - e1 * ray[c]) / towards
            for r in range(2):
                along = B[r, 0] * dx + B[r, 1] * dy + B[r, 2] * dz
                B[r, 0] = (B[r, 0] - along * dx) / distance
                B[r, 1] = (B[r, 1] - along * dy) / distance
                B[r, 2] = (B[r, 2] - along * dz) / distance
            for r in range(3):
                q[r] += w * (B[0, r] * e0 + B[1, r] * e1)
                for c in range(3):
                    P[r, c] += w * (B[0, r] * B[0, c] + B[1, r] * B[1, c])
        if not found:
            continue
        n = 0
        while n < model.chains.shape[1] and model.chains[label, n] >= 0:
            d = model.chains[label, n]
            o = points[model.dof_joint[d]]
            a = axes[d]
            x, y, z = X[0] - o[0], X[1] - o[1], X[2] - o[2]
            J[n, 0] = a[1] * z - a[2] * y
            J[n, 1] = a[2] * x - a[0] * z
            J[n, 2] = a[0] * y - a[1] * x
            for r in range(3):
                PJ[n, r] = P[r, 0] * J[n, 0] + P[r, 1] * J[n, 1] + P[r, 2] * J[n, 2]
            g[d] += J[n, 0] * q[0] + J[n, 1] * q[1] + J[n, 2] * q[2]
            for m in range(n + 1):
                H[d, model.chains[label, m]] += (
                    J[m, 0] * PJ[n, 0] + J[m, 1] * PJ[n, 1] + J[m, 2] * PJ[n, 2]
                )
            n += 1
    return energy


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def priors(model, angles, H, g):
    """Add limits, pose and posture prior to H (37,37) and g (37,); return their energy.

    The pseudo-Huber terms enter H with their reweighted curvature, which is never negative.
    """
    energy = 0.0
    for d in range(len(angles)):
        over = angles[d] - model.limits[d, 1]
        under = model.limits[d, 0] - angles[d]
        beyond = over if over > 0.0 else (-under if under > 0.0 else 0.0)
        if beyond != 0.0:
            energy += model.lambda_limit * beyond * beyond
            g[d] += 2.0 * model.lambda_limit * beyond
            H[d, d] += 2.0 * model.lambda_limit
        x = angles[d] / model.spread[d]
        root = np.sqrt(1.0 + x * x)
        energy += model.lambda_pose * (root - 1.0)
        g[d] += model.lambda_pose * x / root / model.spread[d]
        H[d, d] += model.lambda_pose / root / model.spread[d] ** 2
        pull = 0.0
        for e in range(len(angles)):
            pull += model.posture_precision[d, e] * (angles[e] - model.posture_mean[e])
        for e in range(d + 1):
            H[d, e] += model.posture_precision[d, e]
        g[d] += pull
        energy += 0.5 * pull * (angles[d] - model.posture_mean[d])
    return energy


def information(
    model: Model, angles: Float[Array, "37"], seen: Rays, scale: float, *, with_priors: bool = True
) -> tuple[Float[Array, "37 37"], Float[Array, "37"]]:
    """Gauss-Newton matrix and gradient of one frame's detections, and of its priors."""
    H, g = np.zeros((len(angles), len(angles))), np.zeros(len(angles))
    detections(model, angles, seen, float(scale), H, g)
    if with_priors:
        priors(model, angles, H, g)
    return H + np.tril(H, -1).T, g


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def motion_term(angles, mean, precision, H, g):
    """Add the motion prior's term for one frame to H (37,37) and g (37,); return its energy.

    Student's t with as many degrees of freedom as angles: half a squared Mahalanobis distance while
    that is small, and robust to motions unlike those learned.
    """
    n = len(angles)
    slope = np.empty(n)
    squared = 0.0
    for d in range(n):
        pull = 0.0
        for e in range(n):
            pull += precision[d, e] * (angles[e] - mean[e])
        slope[d] = pull
        squared += pull * (angles[d] - mean[d])
    share = 1.0 / (1.0 + squared / n)
    for d in range(n):
        g[d] += share * slope[d]
        for e in range(d + 1):
            H[d, e] += share * precision[d, e]
    return 0.5 * n * np.log1p(squared / n)


@njit(cache=True, nogil=True)
def smoothness(model, angles, predicted, scatter, H, g):
    """Add the smoothness term, about the predicted pose; return its energy."""
    energy = 0.0
    for d in range(len(angles)):
        x = (angles[d] - predicted[d]) / scatter[d]
        root = np.sqrt(1.0 + x * x)
        energy += model.lambda_smooth * (root - 1.0)
        g[d] += model.lambda_smooth * x / root / scatter[d]
        H[d, d] += model.lambda_smooth / root / scatter[d] ** 2
    return energy


@njit(cache=True, nogil=True)
def squared_residuals(model, angles, seen, squared):
    """Squared residual of every detection in standard deviations, into (V, 18); missing: inf."""
    centres, rays, whiten, weights = seen
    points, _ = pose_skeleton(model, angles)
    for label in range(len(model.label_points)):
        X = points[model.label_points[label]]
        for v in range(len(centres)):
            squared[v, label] = np.inf
            if weights[v, label] > 0.0:
                ray, W = rays[v, label], whiten[v, label]
                D = X - centres[v]
                D /= max(np.sqrt((D * D).sum()), 1e-6)
                towards = max(1.0 + (ray * D).sum(), 1e-6)
                e0, e1 = 2.0 * (W[0] * D).sum() / towards, 2.0 * (W[1] * D).sum() / towards
                squared[v, label] = e0 * e0 + e1 * e1
