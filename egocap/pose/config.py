"""Settings of the tracker; the command line shows the comments as help."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

from egocap.errors import InputError

SMOOTHINGS = ("interval", "fixed-lag", "gaussian", "none")
MOST_LAG_S = 2.0
MOTION_PRIORS = ("network", "gaussian")


@dataclass(frozen=True)
class TrackerConfig:
    """Weights are those of a negative log-posterior: residuals are in standard deviations.

    In the comment of a field that is on by default, what follows "Off:" is what happens without it.
    """

    smoothing: Literal["interval", "fixed-lag", "gaussian", "none"] = "interval"
    """interval: all frames together, past and future; fixed-lag: the last frames together, each
    pose given those up to `lag` later; gaussian: low-pass over 5 frames; none: each frame given the
    last."""
    lag: float = 0.0
    """Seconds by which poses follow their frames (fixed-lag only, 2 at most)."""
    multistart: bool = True
    """Solve from other starts, too, and keep, per limb, the segments of lower energy (interval), or
    the last frames as a whole (fixed-lag). Off: Solve from one start."""
    appearance_check: bool = True
    """Reject detections of limbs where the images show the background (interval only). Off: Keep
    detections that the images contradict."""
    contacts: bool = True
    """With a head pose: estimate contacts with the ground, and keep planted feet in place on it
    (interval only, with the covariance). Off: Only move the motion into the world."""
    head_turn_sigma: float = 0.0025
    """Standard deviation of given head poses' rotation, radians."""
    head_shift_sigma: float = 0.0025
    """Standard deviation of given head poses' position, metres."""
    estimate_noise: bool = True
    """Widen the detector's uncertainty to what the residuals show (interval only). Off: Use the
    detector's uncertainty as it is."""
    colour: bool = False
    """Refine every frame by the images' colours; needs the covariance."""
    covariance: bool = True
    """Compute the joints' covariances and confidences. Off: Do not compute covariances and
    confidences."""
    synchronise: bool = False
    """Estimate a constant time lag of every view against the first (interval only)."""
    align_cameras: bool = False
    """Estimate a small constant rotation of every view against the first (interval only)."""
    use_detector_sigma: bool = True
    """Weight every detection by the detector's own standard deviation. Off: Give all detections a
    standard deviation of 4 px at an image width of 640."""
    use_modes: bool = True
    """Associate a joint with another mode of its heat map where the body fits it better. Off: Use
    the highest mode alone."""
    fix_swaps: bool = True
    """Exchange left and right arms or legs of a view where the body fits better. Off: Keep left and
    right as detected."""
    swap_cost: float = 6.0
    """Energy that exchanging left and right must save."""
    lambda_detection: float = 1.0
    """Weight of the detections."""
    occluded_weight: float = 0.17
    """Fraction of its weight that a detection of confidence 0 keeps."""
    lambda_limit: float = 200.0
    """Weight of squared angles beyond the anatomical limits, per rad^2 (Eq. 2)."""
    lambda_pose: float = 0.001
    """Weight of the distance from the rest pose, in each angle's prior deviation (Eq. 2)."""
    lambda_posture: float = 0.03
    """Weight of the learned pose prior, a Gaussian with correlations; 0: without."""
    motion_prior: Literal["network", "gaussian"] = "network"
    """network: small networks over time, told the head's motion where it is given; gaussian: a
    stationary Gaussian process."""
    lambda_motion: float = 1.0
    """Weight of the learned motion prior; 0: without."""
    motion_information: float = 0.3
    """Fraction of the detections' information given to the Gaussian motion prior: errors are
    correlated."""
    lambda_smooth: float = 1.0
    """Weight of the distance from the pose predicted from the past two frames (Eq. 3)."""
    zeta: float = 0.25
    """Fraction of the last velocity that the prediction keeps (Eq. 3)."""
    velocity_sigma: float = 4.0
    """Standard deviation of the prediction, in each angle's prior deviation per second."""
    acceleration_sigma: float = 1.2
    """Standard deviation of the accelerations that `interval` allows, relative to each angle's."""
    robust_scale: float = 3.0
    """Residual, in standard deviations, beyond which a detection is treated as an outlier."""
    inlier_threshold: float = 5.0
    """Residual, in standard deviations, below which a detection is an inlier of a pose."""
    pixel_floor: float = 0.5
    """Minimum standard deviation of a detection, in pixels at an image width of 640."""
    model_error_m: float = 0.004
    """Standard deviation of true joints about the tracker's skeleton, metres."""
    colour_size: int = 64
    """Width and height in pixels to which every view is reduced for `colour`."""
    colour_weight: float = 0.005
    """Weight of one pixel's colour."""
    adapt_illumination: bool = True
    """Adapt the person's colours to slow changes of the light. Off: Keep the learned colours."""
    max_iterations: int = 20
    """Maximum solver steps per frame."""
    tolerance: float = 1e-4
    """Relative decrease of the energy below which a frame has converged."""
    min_inlier_ratio: float = 0.75
    """Inlier ratio of a frame below which the track is lost and all initial poses are tried."""
    reinit_interval_s: float = 0.1
    """Seconds before a frame that stays lost is initialised again."""
    reinit_gain: float = 4.0
    """A new pose replaces the tracked one if it explains this many more detections."""
    gaussian_sigma_frames: float = 1.0
    """Standard deviation of the Gaussian low-pass, frames (5 frames wide)."""

    def __post_init__(self) -> None:
        if self.smoothing not in SMOOTHINGS:
            raise InputError(f"smoothing '{self.smoothing}'", valid=SMOOTHINGS)
        if self.lag > 0.0 and self.smoothing != "fixed-lag":
            raise InputError(f"lag {self.lag:g} s with smoothing '{self.smoothing}'",
                             valid="smoothing 'fixed-lag', or lag 0")  # fmt: skip
        if self.lag > MOST_LAG_S:
            raise InputError(f"lag = {self.lag:g} s", valid=f"0 to {MOST_LAG_S:g} s")
        if self.motion_prior not in MOTION_PRIORS:
            raise InputError(f"motion prior '{self.motion_prior}'", valid=MOTION_PRIORS)
        positive = (
            "velocity_sigma", "acceleration_sigma", "robust_scale", "inlier_threshold",
            "pixel_floor", "max_iterations", "head_turn_sigma", "head_shift_sigma",
        )  # fmt: skip
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, bool | str):
                continue
            if not 0.0 <= value < float("inf"):
                raise InputError(f"{field.name} = {value}", valid="a number from 0")
            if field.name in positive and value <= 0:
                raise InputError(f"{field.name} = {value}", valid="a number above 0")
        if self.colour and not self.covariance:
            raise InputError("colour without covariance", valid="covariance, or no colour")
        if self.occluded_weight > 1.0:
            raise InputError(f"occluded_weight = {self.occluded_weight}", valid="0 to 1")

    @property
    def solves_world(self) -> bool:
        """Whether contacts are estimated, if there are head poses."""
        return self.contacts and self.covariance and self.smoothing == "interval"

    @property
    def checks_appearance(self) -> bool:
        """Whether detections are checked against images, if there are any."""
        return self.appearance_check and self.covariance and self.smoothing == "interval"
