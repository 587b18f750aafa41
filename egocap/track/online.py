"""Online tracking: one frame's detections in, a pose and its uncertainty out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from threadpoolctl import ThreadpoolController

from egocap.body.kinematics import label_positions
from egocap.body.proportions import Proportions
from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.errors import InputError
from egocap.pose.config import TrackerConfig
from egocap.pose.kernel import Model, information, make_model
from egocap.pose.observations import Observations, observe
from egocap.track.fixed_lag import FixedLagSmoother, LaggedPose
from egocap.track.online_filter import OnlineFilter
from egocap.track.uncertainty import confidences, joint_covariances, update_covariance

ONLINE = TrackerConfig(smoothing="fixed-lag")
"""Settings of a tracker that knows past frames only."""


@dataclass(frozen=True, eq=False)
class PoseEstimate:
    """The pose of one frame, given the frames up to it, or up to a lag after it."""

    time: float  # s
    angles: Float[Array, "37"]
    joints_head: Float[Array, "18 3"]
    covariance: Float[Array, "18 3 3"]  # of the joints, m^2
    confidence: Float[Array, "18"]  # probability that a joint is within 5 cm
    converged: bool
    T_world_head: Float[Array, "4 4"] | None = None  # where it is known


class OnlineTracker:
    """Tracks a person of known proportions frame by frame. Not to be shared between threads.

    With a lag of the settings, poses follow their frames by as much. Raises InputError for settings
    that need all frames, or images.
    """

    def __init__(self, rig: Rig, proportions: Proportions, config: TrackerConfig = ONLINE) -> None:
        if config.smoothing not in ("fixed-lag", "none") or config.colour:
            raise InputError(
                f"smoothing '{config.smoothing}', colour {config.colour} for online tracking",
                valid="fixed-lag or none, False",
            )
        self.rig, self.proportions, self.config = rig, proportions, config
        model = make_model(proportions, config)
        self._solver = (
            FixedLagSmoother(proportions, model, config)
            if config.smoothing == "fixed-lag" else _Causal(model, config)
        )  # fmt: skip
        self._time = -np.inf
        self._threads = ThreadpoolController()

    def step(
        self, detections: Detections, T_world_head: Float[Array, "4 4"] | None = None
    ) -> list[PoseEstimate]:
        """The pose of the next frame (T = 1), or those of frames that are older by the lag.

        None while no frame is so old; several where the frame rate falls. `T_world_head` is the
        frame's head pose where it is known, in a world with z up, which the motion prior uses.
        Raises InputError for other than one frame, or one that is not later than the last.
        """
        if len(detections.times) != 1:
            raise InputError(f"{len(detections.times)} frames at once", valid="1")
        time = float(detections.times[0])
        require_later(time, self._time)
        # Matrices of 37 rows gain nothing from BLAS threads.
        with self._threads.limit(limits=1, user_api="blas"):
            proposed = observe(detections, self.rig, self.proportions, self.config)
            poses = self._solver.step(proposed, T_world_head)
            self._time = time
            return [self._estimate(pose) for pose in poses]

    def finish(self) -> list[PoseEstimate]:
        """The poses that the lag withheld, at the end; none without a lag."""
        return [self._estimate(pose) for pose in self._solver.finish()]

    def _estimate(self, pose: LaggedPose) -> PoseEstimate:
        covariance = joint_covariances(
            self.proportions, pose.angles[None], pose.covariance[None], self.config.model_error_m
        )
        joints = label_positions(self.proportions, pose.angles[None])[0]
        return PoseEstimate(
            pose.time, pose.angles, joints, covariance[0], confidences(covariance)[0],
            pose.converged, pose.T_world_head,
        )  # fmt: skip


class _Causal:
    """The causal filter with the covariance given the past."""

    def __init__(self, model: Model, config: TrackerConfig) -> None:
        self.model, self.config = model, config
        self._filter = OnlineFilter(model, config)
        self._time: float | None = None
        self._covariance: Float[Array, "37 37"] | None = None

    def step(
        self, proposed: Observations, T_world_head: Float[Array, "4 4"] | None
    ) -> list[LaggedPose]:
        """The pose of the next frame (T = 1)."""
        time = float(proposed.times[0])
        angles, converged, chosen = self._filter.step(proposed)
        H, _ = information(self.model, angles, chosen.frame(0), self.config.robust_scale)
        elapsed = 0.0 if self._time is None else time - self._time
        drift = self.config.velocity_sigma * elapsed
        self._covariance, self._time = update_covariance(self._covariance, H, drift), time
        return [LaggedPose(time, angles, self._covariance, converged, chosen, T_world_head)]

    def finish(self) -> list[LaggedPose]:
        """No pose is withheld."""
        return []


def require_later(time: float, last: float) -> float:
    """Seconds from the last frame to this one. Raises InputError if it is not later."""
    if not time > last:
        raise InputError(f"a frame of {time:g} s after one of {last:g} s", valid="later ones")
    return time - last
