"""The live pass: every frame solved from its past alone, recovering from scratch when lost."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.skeleton import DOF_COUNT, SPREAD
from egocap.track.config import TrackerConfig
from egocap.track.energy import predict
from egocap.track.kernel import Model, squared_residuals
from egocap.track.observations import Observations
from egocap.track.solver import solve_frame
from egocap.track.starts import start_poses

_WIDE = 10.0
"""Factor on the robust scale while a pose is sought: far residuals must still pull."""
_NO_SCATTER = np.zeros(0)


def track_causally(
    observations: Observations, model: Model, config: TrackerConfig
) -> tuple[Float[Array, "T 37"], Bool[Array, "T"]]:
    """Angles and convergence of every frame, each from the frames before it."""
    times = observations.times
    angles = np.zeros((len(times), DOF_COUNT))
    converged = np.zeros(len(times), bool)
    retry = -np.inf
    for t in range(len(times)):
        frame = _Frame(observations, t, model, config)
        if t > 0:
            step = times[t] - times[t - 1]
            # After a pause (dropped frames) the last velocity says nothing.
            fresh = t < 2 or step > 2.0 * (times[t - 1] - times[t - 2])
            predicted = predict(angles[t - 1], angles[t - 1 if fresh else t - 2], config.zeta)
            scatter = config.speed * step * SPREAD
            angles[t], converged[t] = frame.solve(predicted, predicted, scatter)
        if times[t] >= retry and (t == 0 or not frame.agrees(angles[t])):
            angles[t], converged[t] = frame.search(angles[t])
            if not frame.agrees(angles[t]):
                retry = times[t] + config.retry_s
    return angles, converged


class _Frame:
    """One frame's data beside the model and settings."""

    def __init__(
        self, observations: Observations, t: int, model: Model, config: TrackerConfig
    ) -> None:
        self.data = (
            observations.centres, observations.rays[t], observations.whiten[t],
            observations.weights[t],
        )  # fmt: skip
        self.model, self.config = model, config

    def solve(
        self,
        start: Float[Array, "37"],
        predicted: Float[Array, "37"],
        scatter: Float[Array, "37"],
    ) -> tuple[Float[Array, "37"], bool]:
        angles, _, converged, _ = self._minimise(start, predicted, scatter, 1.0)
        return angles, converged

    def search(self, last: Float[Array, "37"]) -> tuple[Float[Array, "37"], bool]:
        """The lowest energy reached from the last pose and from all starting poses."""
        found = []
        for start in (last, *start_poses()):
            near = self._minimise(start, start, _NO_SCATTER, _WIDE)[0]
            found.append(self._minimise(near, near, _NO_SCATTER, 1.0))
        angles, _, converged, _ = min(found, key=lambda result: result[1])
        return angles, converged

    def agrees(self, angles: Float[Array, "37"]) -> bool:
        """Whether enough of the frame's detections lie within the robust scale of the pose."""
        weights = self.data[3]
        squared = np.empty_like(weights)
        squared_residuals(self.model, angles, *self.data, squared)
        count = np.count_nonzero(weights)
        inliers = np.count_nonzero(squared < self.config.robust_scale**2)
        return inliers >= self.config.lost_share * count

    def _minimise(
        self,
        start: Float[Array, "37"],
        predicted: Float[Array, "37"],
        scatter: Float[Array, "37"],
        widening: float,
    ) -> tuple[Float[Array, "37"], float, bool, int]:
        scale = widening * self.config.robust_scale
        iterations, tolerance = int(self.config.max_iterations), self.config.tolerance
        return solve_frame(
            self.model, start, predicted, scatter, *self.data, scale, iterations, tolerance
        )
