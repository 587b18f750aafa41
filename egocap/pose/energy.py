"""The tracker's energy, readable: one small function a term, in float64.

Every energy is a negative log-posterior up to a constant. `egocap.pose.kernel` computes the same
sums and their derivatives fast; this module is its oracle.

Source: EgoCap 2016, equations 1 to 3; the detection term is the modern alternative to 4.3.3.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.skeleton import LIMITS, SPREAD, HasOffsets, forward
from egocap.geometry import unit
from egocap.pose.config import TrackerConfig
from egocap.pose.observations import OPPOSITE, Rays
from egocap.pose.pose_prior import Posture, load_posture

FARTHEST = 1e6
"""Residual of the direction opposite to a ray, standard deviations."""


def angular_residual(
    joints_head: Float[Array, "*batch 3"],
    centre: Float[Array, "3"],
    ray: Float[Array, "*batch 3"],
    whiten: Float[Array, "*batch 2 3"],
) -> Float[Array, "*batch 2"]:
    """How far the direction to a joint lies from the detected ray, in standard deviations.

    The direction d is projected stereographically onto the plane across the ray r: its distance is
    2 tan(angle / 2), close to the angle when small, and it keeps growing beyond 90 degrees. For the
    opposite direction, and for a joint in the camera's centre, it is FARTHEST.
    """
    offset = joints_head - centre
    direction = unit(offset)
    across = np.einsum("...ij,...j->...i", whiten, direction)
    towards = 1.0 + np.sum(ray * direction, axis=-1)
    seen = (towards > OPPOSITE) & (np.linalg.norm(offset, axis=-1) > OPPOSITE)
    residual = 2.0 * across / np.where(seen, towards, 1.0)[..., None]
    return np.where(seen[..., None], residual, FARTHEST)


def robust(squared: Float[Array, "*batch"], scale: float) -> Float[Array, "*batch"]:
    """Geman-McClure loss of a squared residual: x for small x, never above scale^2.

    Source: Geman & McClure 1985, as in Black & Rangarajan, IJCV 1996, with sigma = scale^2.
    """
    return squared * scale**2 / (squared + scale**2)


def pseudo_huber(x: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """sqrt(1 + x^2) - 1: quadratic near zero, linear far out.  Source: EgoCap 2016, equation 2."""
    return np.sqrt(1.0 + np.square(x)) - 1.0


def detection_energy(
    proportions: HasOffsets,
    angles: Float[Array, "37"],
    seen: Rays,
    scale: float,
) -> float:
    """Disagreement of one frame's pose with its detections in all views."""
    joints = forward(proportions, angles)
    residual = angular_residual(joints, seen.centres[:, None], seen.rays, seen.whiten)
    return float(0.5 * np.sum(seen.weights * robust(np.sum(residual**2, axis=-1), scale)))


def limit_energy(angles: Float[Array, "37"], weight: float) -> float:
    """Squared angles beyond the anatomical limits.  Source: EgoCap 2016, equation 2."""
    over = np.maximum(0.0, angles - LIMITS[:, 1])
    under = np.maximum(0.0, LIMITS[:, 0] - angles)
    return float(weight * np.sum(over**2 + under**2))


def pose_energy(angles: Float[Array, "37"], weight: float) -> float:
    """Distance from the rest pose, in prior deviations.  Source: EgoCap 2016, equation 2."""
    return float(weight * np.sum(pseudo_huber(angles / SPREAD)))


def posture_energy(angles: Float[Array, "37"], posture: Posture, weight: float) -> float:
    """The learned pose prior: half a squared Mahalanobis distance."""
    departure = angles - posture.mean
    return float(0.5 * weight * departure @ posture.precision @ departure)


def predict(
    last: Float[Array, "37"], before_last: Float[Array, "37"], zeta: float
) -> Float[Array, "37"]:
    """The pose predicted from the last two.  Source: EgoCap 2016, equation 3."""
    return last + zeta * (last - before_last)


def smoothness_energy(
    angles: Float[Array, "37"],
    predicted: Float[Array, "37"],
    scatter: Float[Array, "37"],
    weight: float,
) -> float:
    """Distance from the predicted pose, in `scatter`.  Source: EgoCap 2016, equation 3."""
    return float(weight * np.sum(pseudo_huber((angles - predicted) / scatter)))


def acceleration_energy(
    angles: Float[Array, "T 37"], stencil: Float[Array, "T 3"], density: Float[Array, "37"]
) -> float:
    """Accelerations between the poses, in their standard deviation.

    Row t of `stencil` weighs the poses t, t + 1, t + 2 (see `acceleration_stencil`).
    """
    parts = [
        stencil[: len(angles) - 2, k, None] * angles[k : len(angles) - 2 + k] for k in range(3)
    ]
    return float(np.sum(pseudo_huber(sum(parts) / density)))


def acceleration_stencil(times: Float[Array, "T"]) -> Float[Array, "T 3"]:
    """Second differences of unevenly spaced samples, scaled to unit variance.

    For white acceleration of density 1 the second divided difference over steps of h has a
    variance of about 1 / h, so that the prior's energy is its square times h. The last two rows,
    which would reach beyond the end, are zero.
    """
    stencil = np.zeros((len(times), 3))
    if len(times) < 3:
        return stencil
    first, second = np.diff(times)[:-1], np.diff(times)[1:]
    mean = (first + second) / 2
    scale = np.sqrt(mean) / mean
    stencil[:-2] = np.stack([scale / first, -scale * (1 / first + 1 / second), scale / second], -1)
    return stencil


def frame_energy(
    proportions: HasOffsets,
    angles: Float[Array, "37"],
    seen: Rays,
    config: TrackerConfig,
) -> float:
    """Energy of one frame: detections, limits, priors."""
    return (
        detection_energy(proportions, angles, seen, config.robust_scale)
        + limit_energy(angles, config.lambda_limit)
        + pose_energy(angles, config.lambda_pose)
        + posture_energy(angles, load_posture(), config.lambda_posture)
    )
