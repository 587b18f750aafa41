"""Detections, pose prior and smoothness as the paper has them, with their gradient, compiled.

    E_detection = -sum over views and labels of  lambda w exp(-d^2 / (2 sigma^2))
    E_pose      = lambda_limit sum over^2 + lambda_pose sum huber(p)
    E_smooth    = lambda_smooth sum huber(predicted - p),     huber(x) = sqrt(1 + x^2) - 1

d is the distance of a body part from the ray of its detection and w the detection's confidence.

Source: EgoCap 2016, equations 2 and 3 and section 4.3.3.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from egocap.body.kinematics import pose_skeleton


@njit(cache=True)
def detection_agreement(model, angles, centres, rays, weights, sigma, g):
    """E_detection of weights (V, 18), which hold lambda; its gradient is added to g (37,)."""
    points, axes = pose_skeleton(model, angles)
    energy = 0.0
    D, force, lever = np.empty(3), np.empty(3), np.empty(3)
    for label in range(len(model.label_points)):
        X = points[model.label_points[label]]
        force[:] = 0.0
        for v in range(len(centres)):
            if weights[v, label] <= 0.0:
                continue
            D[:] = X - centres[v]
            along = (D * rays[v, label]).sum()
            if along > 0.0:  # else the ray's beginning is nearest
                D -= along * rays[v, label]
            agreement = weights[v, label] * np.exp(-0.5 * (D * D).sum() / sigma**2)
            energy -= agreement
            force += agreement / sigma**2 * D
        for n in range(model.chains.shape[1]):
            d = model.chains[label, n]
            if d < 0:
                break
            lever[:] = X - points[model.dof_joint[d]]
            g[d] += (
                axes[d, 0] * (lever[1] * force[2] - lever[2] * force[1])
                + axes[d, 1] * (lever[2] * force[0] - lever[0] * force[2])
                + axes[d, 2] * (lever[0] * force[1] - lever[1] * force[0])
            )
    return energy


@njit(cache=True)
def pose_prior(model, angles, lambda_pose, lambda_limit, g):
    """E_pose; its gradient is added to g (37,)."""
    energy = 0.0
    for d in range(len(angles)):
        over = max(0.0, angles[d] - model.limits[d, 1])
        under = max(0.0, model.limits[d, 0] - angles[d])
        root = np.sqrt(1.0 + angles[d] ** 2)
        energy += lambda_limit * (over**2 + under**2) + lambda_pose * (root - 1.0)
        g[d] += 2.0 * lambda_limit * (over - under) + lambda_pose * angles[d] / root
    return energy


@njit(cache=True)
def smoothness(angles, predicted, lambda_smooth, g):
    """E_smooth; its gradient is added to g (37,)."""
    energy = 0.0
    for d in range(len(angles)):
        x = angles[d] - predicted[d]
        root = np.sqrt(1.0 + x * x)
        energy += lambda_smooth * (root - 1.0)
        g[d] += lambda_smooth * x / root
    return energy
