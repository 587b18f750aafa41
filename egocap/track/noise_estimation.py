"""Estimation of a detector's noise from the residuals of a track: standard deviation, correlation.

The standard deviation of a label is the median of its residuals relative to that of the stated
Gaussian, and is never lowered. The correlation from frame to frame reduces the number of
independent frames. The smoother applies part of that reduction (an exponent of 0.25): without any,
jitter of the detector remains; with all of it, robust terms reject whole limbs and priors dominate
where the detector errs for long. Covariances apply all of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.skeleton import HasOffsets, forward
from egocap.pose.energy import angular_residual
from egocap.pose.observations import Observations

_MEDIAN = 2.0 * np.log(2.0)
"""Median of the squared length of a standard Gaussian in the plane."""
_MIN_SAMPLES = 60
"""Detections of a label from which its own standard deviation is estimated."""
_MAX_FACTOR = 5.0
_SMOOTHER_EXPONENT = 0.25
"""Exponent of the fraction of independent frames, as the smoother's weight of detections. Chosen on
footage of training clips, where 0.5 costs 6 % more error; on validation clips both are equal."""
_MAX_CORRELATION = 0.9
_CLIP = 3.0  # standard deviations, beyond which a residual is clipped


@dataclass(frozen=True, eq=False)
class NoiseEstimate:
    """Factors on the stated standard deviations, and correlation from frame to frame."""

    sigma_factor: Float[Array, "18"]  # at least 1
    correlation: float  # 0 to below 1

    @property
    def independent_fraction(self) -> float:
        """Fraction of the frames that count as independent."""
        return (1.0 - self.correlation) / (1.0 + self.correlation)

    @property
    def is_significant(self) -> bool:
        """Whether it differs enough from the stated noise to solve again."""
        return bool(self.sigma_factor.max() > 1.05 or self.correlation > 0.05)


def estimate_noise(
    angles: Float[Array, "T 37"], observations: Observations, proportions: HasOffsets
) -> NoiseEstimate:
    """The detections' noise given the poses; as stated where there are too few."""
    joints = forward(proportions, angles)[:, None]
    residual = angular_residual(
        joints, observations.centres[:, None], observations.rays, observations.whiten
    )
    valid = observations.weights > 0.0
    squared = np.sum(residual**2, axis=-1)
    overall = _sigma_factor(squared, valid)
    factor = np.array([
        _sigma_factor(squared[..., j], valid[..., j])
        if valid[..., j].sum() >= _MIN_SAMPLES else overall
        for j in range(squared.shape[-1])
    ])  # fmt: skip
    correlation = autocorrelation(residual / factor[:, None], valid)
    return NoiseEstimate(factor, min(correlation, _MAX_CORRELATION))


def autocorrelation(residual: Float[Array, "T V 18 2"], valid: Bool[Array, "T V 18"]) -> float:
    """Correlation of residuals, in standard deviations, from each frame to the next: 0 to 0.99.

    0 where there are too few.
    """
    both = valid[1:] & valid[:-1]
    if np.count_nonzero(both) < _MIN_SAMPLES:
        return 0.0
    now, then = (np.clip(part[both], -_CLIP, _CLIP) for part in (residual[1:], residual[:-1]))
    power = 0.5 * (np.sum(now**2) + np.sum(then**2))
    return float(np.clip(np.sum(now * then) / max(power, 1e-12), 0.0, 0.99))


def apply_noise(observations: Observations, noise: NoiseEstimate) -> Observations:
    """The observations with that noise, for the smoother."""
    scale, modes = 1.0 / noise.sigma_factor[:, None, None], observations.modes
    if modes is not None:
        modes = replace(modes, whiten=modes.whiten * scale)
    widened = replace(observations, whiten=observations.whiten * scale, modes=modes)
    return widened.weighted(noise.independent_fraction**_SMOOTHER_EXPONENT)


def weight_as_independent(observations: Observations, noise: NoiseEstimate) -> Observations:
    """Observations of `apply_noise` with the weights of independent frames alone, for covariances.

    Modes are left out.
    """
    rest = noise.independent_fraction ** (1.0 - _SMOOTHER_EXPONENT)
    return replace(observations, weights=observations.weights * rest, modes=None)


def _sigma_factor(squared: Array, valid: Bool[Array, "*same"]) -> float:
    if np.count_nonzero(valid) < _MIN_SAMPLES:
        return 1.0
    return float(np.clip(np.sqrt(np.median(squared[valid]) / _MEDIAN), 1.0, _MAX_FACTOR))
