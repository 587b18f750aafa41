"""Settings of the posterior; the command line shows the comments as help."""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import inf, isnan

from egocap.errors import InputError

FIRST_CHECK = 500
"""Steps before a chain is checked first."""
LEAST_WALKERS = 4
"""Chains that an R-hat needs."""


@dataclass(frozen=True)
class PosteriorConfig:
    """Prior, and noise of the detections."""

    degrees: float = 5.0
    """Degrees of freedom of the detections' Student-t errors, above 2; inf: Gaussian."""
    temperature: float = 1.0
    """Divides the logarithm of the likelihood; above 1 weakens the detections."""
    default_sigma: float = 4.0
    """Spread of detections without one, in pixels at an image width of 640."""
    pixel_floor: float = 0.5
    """Least spread of a detection, in pixels at an image width of 640."""
    model_error_m: float = 0.004
    """Scatter of true joints about the skeleton, metres."""
    least_confidence: float = 0.1
    """Detections less confident than this count as missing."""
    limit_weight: float = 200.0
    """Stiffness of the anatomical limits, per rad^2: beyond them the prior falls as exp(-w x^2)."""
    bone_scales: bool = False
    """Also infer how much longer or shorter than stated the trunk's and the limbs' bones are."""
    bone_scale_sd: float = 0.03
    """Standard deviation of the bones' lengths, as a share, before the detections."""
    rig_errors: bool = False
    """Also infer how far each camera is turned and shifted from its calibration."""
    rig_turn_sd_deg: float = 0.3
    """Standard deviation of a camera's orientation about each axis, degrees."""
    rig_shift_sd_m: float = 0.002
    """Standard deviation of a camera's position along each axis, metres."""

    def __post_init__(self) -> None:
        if not self.degrees > 2.0:
            raise InputError(f"degrees = {self.degrees}", valid="above 2, inf for Gaussian errors")
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, bool) or field.name == "degrees":
                continue
            zero_ok = field.name in ("model_error_m", "least_confidence", "pixel_floor")
            if isnan(value) or value == inf or value < 0.0 or (value == 0.0 and not zero_ok):
                valid = "a number from 0" if zero_ok else "a number above 0"
                raise InputError(f"{field.name} = {value}", valid=valid)


@dataclass(frozen=True)
class SamplerConfig:
    """Length of the chain and number of walkers."""

    walkers: int = 8
    """Number of walkers; each is a chain."""
    effective: float = 400.0
    """Effective draws to reach for every parameter, in the bulk and in the tails."""
    most_steps: int = 20_000
    """Limit on the steps of a chain that does not converge."""
    seed: int = 0
    """Seed of the starting poses and of the chain."""

    def __post_init__(self) -> None:
        if self.walkers < LEAST_WALKERS:
            raise InputError(f"{self.walkers} walkers", valid=f"{LEAST_WALKERS} or more")
        if not 0.0 < self.effective < inf:
            raise InputError(f"{self.effective} effective draws", valid="a number above 0")
        if self.most_steps < FIRST_CHECK:
            raise InputError(f"{self.most_steps} steps", valid=f"{FIRST_CHECK} or more")
        if not 0 <= self.seed < 2**32:
            raise InputError(f"seed {self.seed}", valid="0 to 2^32 - 1")
