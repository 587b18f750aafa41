"""Poses drawn from the prior and detections drawn from the likelihood.

On these a posterior must be calibrated for any rig and noise: `egocap-eval calibration` tests it.
Source: Talts et al. 2018, "Validating Bayesian inference algorithms with simulation-based
calibration".
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.labels import LABELS
from egocap.body.proportions import Proportions
from egocap.body.skeleton import LIMITS, forward
from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.errors import InputError
from egocap.pose.observations import REFERENCE_WIDTH
from egocap.pose.pose_prior import load_posture
from egocap.posterior.config import PosteriorConfig


def draw_poses(
    count: int, config: PosteriorConfig, rng: np.random.Generator
) -> Float[Array, "B 37"]:
    """Exact draws of poses from the prior: the posture's Gaussian with rejection by the limits."""
    posture = load_posture()
    root = np.linalg.cholesky(np.linalg.inv(posture.precision))
    kept, have = [np.zeros((0, len(LIMITS)))], 0
    while have < count:
        tried = posture.mean + rng.standard_normal((max(8 * count, 256), len(LIMITS))) @ root.T
        beyond = np.maximum(0.0, np.maximum(tried - LIMITS[:, 1], LIMITS[:, 0] - tried))
        chance = np.exp(-config.limit_weight * np.sum(beyond**2, axis=-1))
        good = tried[rng.random(len(tried)) < chance]
        kept.append(good)
        have += len(good)
    return np.concatenate(kept)[:count]


def draw_noise(
    shape: tuple[int, ...], degrees: float, rng: np.random.Generator
) -> Float[Array, "*shape 2"]:
    """Pixel errors of unit standard deviation along each axis: bivariate Student-t, or Gaussian."""
    normal = rng.standard_normal((*shape, 2))
    if np.isinf(degrees):
        return normal
    mixing = rng.chisquare(degrees, shape) / (degrees - 2.0)
    return normal / np.sqrt(mixing)[..., None]


def draw_detections(
    angles: Float[Array, "B 37"],
    seen: Bool[Array, "B V 18"],
    rig: Rig,
    proportions: Proportions,
    sigma: float,
    config: PosteriorConfig,
    rng: np.random.Generator,
) -> Detections:
    """Detections of poses, one a frame, where `seen` says so, which must not depend on the poses.

    `sigma` is their spread along each axis in pixels at an image width of 640. A point may lie
    outside the image: the likelihood takes it so. Raises InputError for a spread that is not above
    the posterior's floor, or a config whose likelihood nothing can be drawn from.
    """
    if not sigma >= config.pixel_floor or not np.isfinite(sigma) or sigma <= 0.0:
        raise InputError(f"detections with sigma {sigma}", valid=f"from {config.pixel_floor:g} px")
    if config.model_error_m > 0.0 or config.temperature != 1.0:
        raise InputError("a well-specified simulation has no model error and temperature 1",
                         valid="model_error_m = 0, temperature = 1")  # fmt: skip
    pixels, _ = rig.project(forward(proportions, angles))
    spread = sigma * np.array([camera.width for camera in rig.cameras]) / REFERENCE_WIDTH
    shape = (len(angles), len(rig.mounts), len(LABELS))
    points = np.moveaxis(pixels, 0, 1) + spread[:, None, None] * draw_noise(
        shape, config.degrees, rng
    )
    return Detections(
        times=np.arange(len(angles)) / rig.frame_rate,
        points=np.where(seen[..., None], points, np.nan),
        sigma=np.broadcast_to(spread[:, None], shape).copy(),
        confidence=seen.astype(float),
        valid=np.array(seen),
        source=f"drawn:{sigma:g},degrees={config.degrees:g}",
    )
