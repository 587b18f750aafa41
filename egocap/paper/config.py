"""Settings of the paper's solvers, `reference` and `stochastic`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Literal

from egocap.errors import InputError

PaperSolverName = Literal["reference", "stochastic"]
SolverName = Literal["fast", "reference", "stochastic"]


@dataclass(frozen=True)
class PaperConfig:
    """Energy and descent of EgoCap 2016, equations 1 to 6; a weight of 0 leaves a term out.

    The paper leaves open over what the colour energy is summed and how large a detection's Gaussian
    is. A sum over pixels would be tens of thousands of times the other terms; here it is the mean
    over all rays of both views, at which a centimetre of a limb changes colour and detections about
    equally.
    """

    size: tuple[int, int] = (128, 128)
    """Width and height in pixels to which every view is reduced."""
    iterations: int = 200
    """Gradient steps a frame."""
    rays: int = 0
    """Random rays a step; 0: all of them, and steps conditioned by the gradient's signs."""
    keep: float = 1.0
    """Fraction of the Gaussians, drawn for every ray, that get its derivative."""
    lambda_colour: float = 1.0
    """Weight of the mean dissimilarity of all rays (Eq. 5 and 6)."""
    lambda_detection: float = 1.0 / 3.0
    """Weight of one detection of full confidence (section 4.3.3)."""
    lambda_pose: float = 1e-4
    """Weight of the distance from the rest pose (Eq. 2)."""
    lambda_limit: float = 0.1
    """Weight of squared angles beyond the anatomical limits, per rad^2 (Eq. 2)."""
    lambda_smooth: float = 0.1
    """Weight of the distance from the pose predicted from the past two frames (Eq. 3)."""
    zeta: float = 0.25
    """Fraction of the last velocity that the prediction keeps (Eq. 3)."""
    detection_sigma: float = 0.1
    """Standard deviation of the Gaussian at a body part, metres."""

    def __post_init__(self) -> None:
        if not all(8 <= side <= 1024 for side in self.size):
            raise InputError(f"images of {self.size} pixels", valid="8 to 1024 a side")
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name != "size" and not 0.0 <= value < float("inf"):
                raise InputError(f"{field.name} = {value}", valid="a number from 0")
        for name in ("iterations", "keep", "detection_sigma"):
            if getattr(self, name) <= 0:
                raise InputError(f"{name} = {getattr(self, name)}", valid="above 0")
        if self.keep > 1.0:
            raise InputError(f"keep = {self.keep}", valid="up to 1")


REFERENCE = PaperConfig()
"""Section 5.2: 200 steps over all pixels of 128 x 128."""
STOCHASTIC = PaperConfig(size=(120, 100), iterations=50, rays=600, keep=0.5)
"""Sections 4.4 and 5.2: 50 steps over random pixels and Gaussians of 120 x 100."""
PAPER_SOLVERS: Mapping[PaperSolverName, PaperConfig] = {
    "reference": REFERENCE,
    "stochastic": STOCHASTIC,
}
