"""How accurate detections really are, from how they scatter about the track made of them.

A learned detector states an accuracy that was true of the footage it was trained on, and its errors
in one frame resemble those in the next. Both are seen in the residuals: their median against that
of the stated Gaussian, and their correlation from frame to frame. Accuracy is only ever lowered.

The smoother takes the second by half. Errors that last are slow, and the slow part of a motion is
not what smoothing takes away: with the weight of the few independent frames alone, robust terms
give whole limbs up and priors lead them astray; with the full weight, more of the detector's
shaking comes through. How sure a track is goes by the slow part, where a run of frames tells little
more than one: its covariance takes both.
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
_ENOUGH = 60
"""Detections of one joint from which its own accuracy is estimated."""
_WIDEST = 5.0
_MEMORY = 0.5
"""Exponent of the share of independent frames, as a weight of detections while smoothing."""
_LONGEST = 0.9  # correlation that is believed
_CLIP = 3.0  # standard deviations; what lies farther says little of everyday errors


@dataclass(frozen=True, eq=False)
class Accuracy:
    """What the residuals say: factors on the stated standard deviations, and correlation."""

    widening: Float[Array, "18"]  # at least 1
    correlation: float  # of one detection's errors in successive frames, 0 to below 1

    @property
    def share(self) -> float:
        """Of the frames, how many count as independent."""
        return (1.0 - self.correlation) / (1.0 + self.correlation)

    @property
    def matters(self) -> bool:
        """Whether it differs from what was stated by enough to solve again."""
        return bool(self.widening.max() > 1.05 or self.correlation > 0.05)


def measure_accuracy(
    angles: Float[Array, "T 37"], observations: Observations, proportions: HasOffsets
) -> Accuracy:
    """Accuracy of the detections as the poses show it; as stated where there are too few."""
    joints = forward(proportions, angles)[:, None]
    residual = angular_residual(
        joints, observations.centres[:, None], observations.rays, observations.whiten
    )
    there = observations.weights > 0.0
    squared = np.sum(residual**2, axis=-1)
    everywhere = _widening(squared, there)
    widening = np.array([
        _widening(squared[..., j], there[..., j]) if there[..., j].sum() >= _ENOUGH else everywhere
        for j in range(squared.shape[-1])
    ])  # fmt: skip
    whitened = residual / widening[:, None]
    return Accuracy(widening, min(lasting(whitened, there), _LONGEST))


def lasting(residual: Float[Array, "T V 18 2"], there: Bool[Array, "T V 18"]) -> float:
    """Correlation of detections' errors, in standard deviations, from each frame to the next.

    0 to 0.99; 0 where there are too few to tell.
    """
    both = there[1:] & there[:-1]
    if np.count_nonzero(both) < _ENOUGH:
        return 0.0
    now, then = (np.clip(part[both], -_CLIP, _CLIP) for part in (residual[1:], residual[:-1]))
    power = 0.5 * (np.sum(now**2) + np.sum(then**2))
    return float(np.clip(np.sum(now * then) / max(power, 1e-12), 0.0, 0.99))


def recalibrated(observations: Observations, accuracy: Accuracy) -> Observations:
    """The observations with that accuracy, for smoothing."""
    narrow, say = 1.0 / accuracy.widening[:, None, None], accuracy.share**_MEMORY
    modes = observations.modes
    if modes is not None:
        modes = replace(modes, whiten=modes.whiten * narrow, weights=modes.weights * say)
    return replace(
        observations, whiten=observations.whiten * narrow, weights=observations.weights * say,
        modes=modes,
    )  # fmt: skip


def independent(observations: Observations, accuracy: Accuracy) -> Observations:
    """What was `recalibrated`, weighed as if no frame told again what the last one did.

    For what all frames together tell; modes are left out.
    """
    left = accuracy.share ** (1.0 - _MEMORY)
    return replace(observations, weights=observations.weights * left, modes=None)


def _widening(squared: Array, there: Bool[Array, "*same"]) -> float:
    if np.count_nonzero(there) < _ENOUGH:
        return 1.0
    return float(np.clip(np.sqrt(np.median(squared[there]) / _MEDIAN), 1.0, _WIDEST))
