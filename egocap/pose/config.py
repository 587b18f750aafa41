"""Settings of the tracker; the command line shows the comments as help."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

from egocap.errors import InputError


@dataclass(frozen=True)
class TrackerConfig:
    """Weights are those of a negative log-posterior: residuals are in standard deviations."""

    solver: Literal["fast", "reference", "stochastic"] = "fast"
    """fast: second order, all below; reference: the paper's 200 gradient steps over all pixels;
    stochastic: its 50 over random ones. Of what is below, these two know the smoothing alone."""
    smoothing: Literal["interval", "gaussian", "none"] = "interval"
    """interval: all frames together, past and future, with a paper's solver like gaussian;
    gaussian: low-pass; none: causal, live."""
    lambda_detection: float = 1.0
    """Weight of the detections."""
    guess_weight: float = 0.1
    """Share of its weight that a guess (confidence 0) keeps; its sigma counts beside it."""
    spread: bool = True
    """Weigh every detection by the accuracy that its detector states; without, all alike."""
    modes: bool = True
    """Let a joint take another of its detector's places where the body fits it better."""
    swaps: bool = True
    """Undo a view's mistaking left for right, arms or legs, where the body fits better."""
    swap_price: float = 6.0
    """Energy that undoing a swap must save."""
    recalibrate: bool = True
    """Widen a detector's stated accuracy to what its residuals show (all frames together only)."""
    restarts: bool = True
    """Seek cheaper motions from elsewhere, for limbs in wrong poses (all frames together only)."""
    look: bool = True
    """Drop detections of limbs where images show what lies behind (all frames together only)."""
    lambda_limit: float = 200.0
    """Weight of squared angles beyond the anatomical limits, per rad^2 (Eq. 2)."""
    lambda_pose: float = 0.001
    """Weight of departing from the rest pose, in units of each angle's everyday spread (Eq. 2)."""
    lambda_posture: float = 0.03
    """Weight of departing from everyday postures, learned with their correlations; 0: without."""
    lambda_motion: float = 1.0
    """Weight of what the learned motion prior makes of past and future; 0: without."""
    motion_share: float = 0.3
    """Share of the detections' information that the motion prior hears: errors last for frames."""
    lambda_smooth: float = 1.0
    """Weight of departing from the motion predicted from the past two frames (Eq. 3)."""
    zeta: float = 0.25
    """Share of the last velocity that the prediction keeps (Eq. 3)."""
    speed: float = 4.0
    """Scatter of the prediction, in spreads per second."""
    acceleration: float = 1.0
    """Scatter of the accelerations that `interval` allows, in units of each angle's agility."""
    robust_scale: float = 3.0
    """Residual, in standard deviations, beyond which a detection loses its say."""
    agreement: float = 5.0
    """Residual, in standard deviations, within which a detection agrees with a pose."""
    pixel_floor: float = 0.5
    """Least standard deviation of a detection, in pixels at an image width of 640."""
    model_error_m: float = 0.004
    """Scatter of true joints about the tracker's skeleton, metres."""
    synchronise: bool = False
    """Estimate how much later every view's pictures are than the first view's (interval only)."""
    align_cameras: bool = False
    """Estimate a small rotation of every view against the first one (interval only)."""
    colour: bool = False
    """Refine every frame by the images' colours; needs the covariance."""
    colour_size: int = 64
    """Width and height in pixels to which every view is reduced for that."""
    colour_weight: float = 0.005
    """Weight of one pixel's colour."""
    follow_light: bool = True
    """Let the person's colours follow slow changes of the light."""
    covariance: bool = True
    """Work out how sure every joint is."""
    max_iterations: int = 20
    """Steps of the solver for one frame."""
    tolerance: float = 1e-4
    """A frame has converged when a step lowers its energy by less than this share."""
    lost_share: float = 0.75
    """Less than this share of a frame's detections agreeing means lost: solved from all starts."""
    retry_s: float = 0.1
    """Seconds before a frame that stays lost is solved from all starts again."""
    jump_gain: float = 4.0
    """A pose found afresh replaces the tracked one if it explains this many more detections."""
    gaussian_frames: float = 1.0
    """Standard deviation of the Gaussian low-pass, frames (5 frames wide)."""

    def __post_init__(self) -> None:
        if self.solver not in ("fast", "reference", "stochastic"):
            raise InputError(f"solver '{self.solver}'", valid=("fast", "reference", "stochastic"))
        if self.smoothing not in ("interval", "gaussian", "none"):
            raise InputError(
                f"smoothing '{self.smoothing}'", valid=("interval", "gaussian", "none")
            )
        for field in fields(self):
            value = getattr(self, field.name)
            if not isinstance(value, bool | str) and not (0.0 <= value < float("inf")):
                raise InputError(f"{field.name} = {value}", valid="a number from 0")
        if self.colour and not self.covariance:
            raise InputError("colour without covariance", valid="both or none")
        if self.guess_weight > 1.0:
            raise InputError(f"guess_weight = {self.guess_weight}", valid="0 to 1")
        for name in (
            "speed",
            "acceleration",
            "robust_scale",
            "agreement",
            "pixel_floor",
            "max_iterations",
        ):
            if getattr(self, name) <= 0:
                raise InputError(f"{name} = {getattr(self, name)}", valid="a number above 0")

    @property
    def looks(self) -> bool:
        """Whether images are asked which detections they deny."""
        return self.look and self.covariance and self.smoothing == "interval"
