"""Tracking as pictures come: one frame's detections in, its pose and how sure it is out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.proportions import Proportions
from egocap.body.skeleton import DOF_COUNT, SPREAD, forward
from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.errors import InputError
from egocap.pose.config import TrackerConfig
from egocap.pose.kernel import detections as detection_term
from egocap.pose.kernel import make_model, priors
from egocap.pose.observations import Observations, observe
from egocap.track.online_filter import Follower
from egocap.track.uncertainty import confidences, joint_covariances


@dataclass(frozen=True, eq=False)
class LivePose:
    """The pose of one frame, from the frames up to it."""

    time: float  # s
    angles: Float[Array, "37"]
    joints_head: Float[Array, "18 3"]
    confidence: Float[Array, "18"]  # chance that a joint is within 5 cm
    converged: bool


class LiveTracker:
    """Follows a person of known proportions frame by frame. Not to be shared between threads.

    Raises InputError for settings that need more than the past, or images.
    """

    def __init__(
        self, rig: Rig, proportions: Proportions,
        config: TrackerConfig = TrackerConfig(smoothing="none"),  # noqa: B008 (frozen)
    ) -> None:  # fmt: skip
        if (config.smoothing, config.solver, config.colour) != ("none", "fast", False):
            raise InputError(
                f"smoothing '{config.smoothing}', solver '{config.solver}', colour {config.colour}",
                valid="live: none, fast, False",
            )
        self.rig, self.proportions, self.config = rig, proportions, config
        self._model = make_model(proportions, config)
        self._follower = Follower(self._model, config)
        self._time = -np.inf
        self._covariance: Float[Array, "37 37"] | None = None

    def step(self, found: Detections) -> LivePose:
        """The pose of the next frame, from its detections (T = 1).

        Raises InputError for other than one frame, or one that is not later than the last.
        """
        if len(found.times) != 1:
            raise InputError(f"{len(found.times)} frames at once", valid="1")
        time = float(found.times[0])
        if not time > self._time:
            raise InputError(f"a frame of {time:g} s after one of {self._time:g} s",
                             valid="later ones")  # fmt: skip
        proposed = observe(found, self.rig, self.proportions, self.config)
        angles, converged, taken = self._follower.step(proposed)
        self._covariance = self._narrowed(angles, taken, time)
        self._time = time
        covariance = joint_covariances(
            self.proportions, angles[None], self._covariance[None], self.config.model_error_m
        )
        joints = forward(self.proportions, angles)
        return LivePose(time, angles, joints, confidences(covariance)[0], converged)

    def _narrowed(
        self, angles: Float[Array, "37"], taken: Observations, time: float
    ) -> Float[Array, "37 37"]:
        """Covariance of the angles: that of the last frame, grown since, and what this one saw."""
        H, g = np.zeros((DOF_COUNT, DOF_COUNT)), np.zeros(DOF_COUNT)
        detection_term(
            self._model, angles, taken.centres, taken.rays[0], taken.whiten[0], taken.weights[0],
            float(self.config.robust_scale), H, g,
        )  # fmt: skip
        priors(self._model, angles, H, g)
        return carried_on(
            H + np.tril(H, -1).T, self._covariance, self.config.speed * (time - self._time)
        )


def carried_on(
    information: Float[Array, "37 37"], last: Float[Array, "37 37"] | None, drift: float
) -> Float[Array, "37 37"]:
    """Covariance of the angles from a frame's own information and what was known at the last.

    `drift` is by how many everyday spreads angles scatter in between.
    """
    if last is None:
        return np.linalg.inv(information)
    grown = last + np.diag(np.square(drift * SPREAD))
    return np.linalg.inv(information + np.linalg.inv(grown))
