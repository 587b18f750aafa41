"""Online tracking: one frame's detections in, its pose and uncertainty out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.proportions import Proportions
from egocap.body.skeleton import forward
from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.errors import InputError
from egocap.pose.config import TrackerConfig
from egocap.pose.kernel import information, make_model
from egocap.pose.observations import observe
from egocap.track.online_filter import OnlineFilter
from egocap.track.uncertainty import confidences, joint_covariances, update_covariance

ONLINE = TrackerConfig(smoothing="none")
"""Settings of a tracker that knows past frames only."""


@dataclass(frozen=True, eq=False)
class PoseEstimate:
    """The pose of one frame, given the frames up to it."""

    time: float  # s
    angles: Float[Array, "37"]
    joints_head: Float[Array, "18 3"]
    confidence: Float[Array, "18"]  # probability that a joint is within 5 cm
    converged: bool


class OnlineTracker:
    """Tracks a person of known proportions frame by frame. Not to be shared between threads.

    Raises InputError for settings that need future frames, or images.
    """

    def __init__(self, rig: Rig, proportions: Proportions, config: TrackerConfig = ONLINE) -> None:
        if (config.smoothing, config.colour) != ("none", False):
            raise InputError(
                f"smoothing '{config.smoothing}', colour {config.colour} for online tracking",
                valid="none, False",
            )
        self.rig, self.proportions, self.config = rig, proportions, config
        self._model = make_model(proportions, config)
        self._filter = OnlineFilter(self._model, config)
        self._time = -np.inf
        self._covariance: Float[Array, "37 37"] | None = None

    def step(self, detections: Detections) -> PoseEstimate:
        """The pose of the next frame, from its detections (T = 1).

        Raises InputError for other than one frame, or one that is not later than the last.
        """
        if len(detections.times) != 1:
            raise InputError(f"{len(detections.times)} frames at once", valid="1")
        time = float(detections.times[0])
        elapsed = require_later(time, self._time)
        proposed = observe(detections, self.rig, self.proportions, self.config)
        angles, converged, chosen = self._filter.step(proposed)
        H, _ = information(self._model, angles, chosen.frame(0), self.config.robust_scale)
        drift = self.config.velocity_sigma * elapsed
        self._covariance, self._time = update_covariance(self._covariance, H, drift), time
        covariance = joint_covariances(
            self.proportions, angles[None], self._covariance[None], self.config.model_error_m
        )
        joints = forward(self.proportions, angles)
        return PoseEstimate(time, angles, joints, confidences(covariance)[0], converged)


def require_later(time: float, last: float) -> float:
    """Seconds from the last frame to this one. Raises InputError if it is not later."""
    if not time > last:
        raise InputError(f"a frame of {time:g} s after one of {last:g} s", valid="later ones")
    return time - last
