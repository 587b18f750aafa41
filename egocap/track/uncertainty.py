"""Uncertainty of a track: covariances of angles and joints, and the joints' confidences.

The inverse of the energy's Gauss-Newton matrix at its minimum is the covariance of the angles:
given all frames where they were solved together, given the past where they were solved one by one.
The skeleton's model error is added to the joints' covariances.

Source: Laplace's approximation.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numba import njit
from numpy import ndarray as Array

from egocap.body.kinematics import LABEL_CHAINS, kinematic_tree, pose_skeleton
from egocap.body.labels import LABELS
from egocap.body.skeleton import DOF_COUNT, SPREAD, HasOffsets
from egocap.pose.banded import banded_inverse
from egocap.pose.config import TrackerConfig
from egocap.pose.kernel import Model, information
from egocap.pose.motion_prior import NO_MOTION_PREDICTION, MotionPrediction
from egocap.pose.observations import Observations
from egocap.track.smoother import interval_system, windows

CORRECT_M = 0.05
"""Distance from the truth, metres, below which a joint counts as correct."""


def interval_covariances(
    angles: Float[Array, "T 37"], observations: Observations, model: Model, config: TrackerConfig,
    prediction: MotionPrediction = NO_MOTION_PREDICTION,
) -> Float[Array, "T 37 37"]:  # fmt: skip
    """Covariance [rad^2] of every frame's angles given all frames."""
    covariances = np.empty((len(angles), DOF_COUNT, DOF_COUNT))
    for kept, window, within in windows(len(angles)):
        _, bands, _ = interval_system(
            angles[window], observations[window], model, config, prediction[window]
        )
        covariances[kept] = banded_inverse(bands, DOF_COUNT)[within]
    return covariances


def causal_covariances(
    angles: Float[Array, "T 37"], observations: Observations, model: Model, config: TrackerConfig
) -> Float[Array, "T 37 37"]:
    """Covariance [rad^2] of every frame's angles given the frames up to it."""
    covariances = np.empty((len(angles), DOF_COUNT, DOF_COUNT))
    steps, last = np.diff(observations.times, prepend=observations.times[:1]), None
    for t, pose in enumerate(np.ascontiguousarray(angles)):
        matrix, _ = information(model, pose, observations.frame(t), config.robust_scale)
        last = update_covariance(last, matrix, config.velocity_sigma * steps[t])
        covariances[t] = last
    return covariances


def update_covariance(
    last: Float[Array, "37 37"] | None, matrix: Float[Array, "37 37"], drift: float
) -> Float[Array, "37 37"]:
    """Covariance of the angles from that at the last frame, if any, and a frame's information.

    `drift` is the standard deviation of the motion in between, in each angle's prior deviation.
    """
    if last is None:
        return np.linalg.inv(matrix)
    predicted = last + np.diag(np.square(drift * SPREAD))
    return np.linalg.inv(matrix + np.linalg.inv(predicted))


def joint_covariances(
    proportions: HasOffsets, angles: Float[Array, "T 37"],
    covariances: Float[Array, "T 37 37"], model_error_m: float,
) -> Float[Array, "T 18 3 3"]:  # fmt: skip
    """Covariance [m^2] of the joints' positions in the head frame."""
    found = np.empty((len(angles), len(LABELS), 3, 3))
    _propagate(
        kinematic_tree(proportions), LABEL_CHAINS, np.ascontiguousarray(angles),
        np.ascontiguousarray(covariances), float(model_error_m), found,
    )  # fmt: skip
    return found


@njit(cache=True, nogil=True)
def _propagate(tree, labels, angles, covariances, model_error, found):
    """J C J^T and the model error's variance, into `found` (T, 18, 3, 3), of every label.

    J is `egocap.body.skeleton.jacobian` with the angles alone that move the label.
    """
    J = np.empty((labels.chains.shape[1], 3))
    for t in range(len(angles)):
        points, axes = pose_skeleton(tree, angles[t])
        for label in range(len(found[t])):
            chain, P = labels.chains[label], found[t, label]
            P[:] = 0.0
            X, count = points[labels.points[label]], 0
            while count < len(chain) and chain[count] >= 0:
                d = chain[count]
                o, a = points[labels.dof_joint[d]], axes[d]
                x, y, z = X[0] - o[0], X[1] - o[1], X[2] - o[2]
                J[count, 0] = a[1] * z - a[2] * y
                J[count, 1] = a[2] * x - a[0] * z
                J[count, 2] = a[0] * y - a[1] * x
                count += 1
            for n in range(count):
                of_angle = covariances[t, chain[n]]
                x = y = z = 0.0  # row n of C J^T
                for m in range(count):
                    c = of_angle[chain[m]]
                    x += c * J[m, 0]
                    y += c * J[m, 1]
                    z += c * J[m, 2]
                for r in range(3):
                    P[r, 0] += J[n, r] * x
                    P[r, 1] += J[n, r] * y
                    P[r, 2] += J[n, r] * z
            for r in range(3):
                P[r, r] += model_error**2


def joint_deviations(
    proportions: HasOffsets, angles: Float[Array, "T 37"],
    covariances: Float[Array, "T 37 37"], model_error_m: float,
) -> Float[Array, "T 18"]:  # fmt: skip
    """Standard deviations [m] of the joints' positions along an axis, as if isotropic."""
    found = joint_covariances(proportions, angles, covariances, model_error_m)
    return np.sqrt(np.maximum(np.trace(found, axis1=-2, axis2=-1) / 3.0, 0.0))


def confidences(covariances: Float[Array, "T 18 3 3"]) -> Float[Array, "T 18"]:
    """Probability that each joint lies within `CORRECT_M` of its estimate: 0 to 1.

    The error is taken as isotropic, so that its length has Maxwell's distribution.
    """
    from scipy.special import erf

    deviation = np.sqrt(np.maximum(np.trace(covariances, axis1=-2, axis2=-1) / 3.0, 1e-12))
    x = CORRECT_M / deviation
    chance = erf(x / np.sqrt(2.0)) - np.sqrt(2.0 / np.pi) * x * np.exp(-0.5 * x**2)
    return np.clip(chance, 0.0, 1.0)
