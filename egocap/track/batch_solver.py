"""Batch solver: observations of a recording in, the motion of all frames out.

With `fixed-lag` smoothing, the last frames are solved with every new one. Else a first motion comes
from the online filter. With `interval` smoothing, association, the cameras'
alignment and the detector's noise are then estimated from it, the smoother runs again, and
multi-start refinement and the motion prior follow.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.proportions import Proportions
from egocap.body.skeleton import forward
from egocap.data.head_pose import HeadPoses
from egocap.pose.config import TrackerConfig
from egocap.pose.kernel import Model
from egocap.pose.motion_prior import NO_MOTION_PREDICTION, MotionPrediction, predict_motion
from egocap.pose.observations import Observations, joined
from egocap.track.association import associate, needs_association
from egocap.track.camera_alignment import Alignment, improve
from egocap.track.fixed_lag import smooth_fixed_lag
from egocap.track.motion_prediction import INDEPENDENT, predict_by_network, undetected
from egocap.track.multistart import changed_frames, merge_segments, solve_multistart
from egocap.track.noise_estimation import apply_noise, estimate_noise, weight_as_independent
from egocap.track.online_filter import filter_both_ways, filter_sequence
from egocap.track.smoother import smooth_gaussian, smooth_interval
from egocap.track.stopwatch import Stopwatch
from egocap.track.uncertainty import causal_covariances, interval_covariances

_ALIGNMENT_STEPS = 4
_MAX_PREDICTIONS = 3


@dataclass(frozen=True, eq=False)
class Solution:
    """The motion of all frames, and what was estimated with it."""

    angles: Float[Array, "T 37"]
    converged: Bool[Array, "T"]
    chosen: Observations  # as associated, with the estimated noise
    independent: Observations  # the same, with the weights of independent frames
    estimated: dict[str, object]  # JSON-ready
    prediction: MotionPrediction  # of the motion prior
    independent_prediction: MotionPrediction  # the same, with the information of independent frames
    covariances: Float[Array, "T 37 37"] | None = None  # rad^2, where they come with the motion


@dataclass(frozen=True, eq=False)
class BatchSolver:
    """Solves all frames of a recording of one person."""

    proportions: Proportions
    model: Model
    config: TrackerConfig

    def solve(
        self, observations: Observations, stopwatch: Stopwatch, heads: HeadPoses | None = None
    ) -> Solution:
        """The motion by the smoothing of the settings; `heads` inform the motion prior."""
        config, known = self.config, (observations, self.model, self.config)
        if config.smoothing == "interval":
            angles, _ = filter_both_ways(*known)
            stopwatch.lap("frames")
            return self._solve_interval(angles, observations, heads, stopwatch)
        if config.smoothing == "fixed-lag":
            solution = self._solve_fixed_lag(observations, heads)
            stopwatch.lap("smoothing")
            return solution
        angles, converged, chosen = filter_sequence(*known)
        stopwatch.lap("frames")
        if config.smoothing == "gaussian":
            angles = smooth_gaussian(angles, config.gaussian_sigma_frames)
            stopwatch.lap("smoothing")
        return Solution(
            angles, converged, chosen, chosen, {}, NO_MOTION_PREDICTION, NO_MOTION_PREDICTION
        )

    def covariances(self, solution: Solution) -> Float[Array, "T 37 37"]:
        """Covariances [rad^2] of a solution's angles."""
        if solution.covariances is not None:
            return solution.covariances
        known = solution.angles, solution.independent, self.model, self.config
        if self.config.smoothing == "interval":
            return interval_covariances(*known, solution.independent_prediction)
        return causal_covariances(*known)

    def _solve_fixed_lag(self, observations: Observations, heads: HeadPoses | None) -> Solution:
        poses = smooth_fixed_lag(observations, self.proportions, self.model, self.config, heads)
        chosen = joined([pose.chosen for pose in poses])
        return Solution(
            np.array([pose.angles for pose in poses]), np.array([p.converged for p in poses]),
            chosen, chosen, {}, NO_MOTION_PREDICTION, NO_MOTION_PREDICTION,
            np.array([pose.covariance for pose in poses]),
        )  # fmt: skip

    def _solve_interval(
        self, angles: Float[Array, "T 37"], observations: Observations, heads: HeadPoses | None,
        stopwatch: Stopwatch,
    ) -> Solution:  # fmt: skip
        config, known = self.config, (self.model, self.config)
        angles, converged, chosen, changed = self._associate(angles, observations)
        stopwatch.lap("smoothing")
        estimated: dict[str, object] = {}
        if (config.synchronise or config.align_cameras) and chosen.weights.shape[1] > 1:
            angles, chosen, alignment = self._align(angles, chosen)
            estimated["lag_s"] = alignment.lag_s.round(5).tolist()
            estimated["rotation_deg"] = np.rad2deg(alignment.rotation).round(4).tolist()
            changed = True
            stopwatch.lap("smoothing")
        noise = None
        if config.estimate_noise:
            noise = estimate_noise(angles, chosen, self.proportions)
            estimated["sigma_factor"] = noise.sigma_factor.round(3).tolist()
            estimated["correlation"] = round(noise.correlation, 3)
            chosen, changed = apply_noise(chosen, noise), changed or noise.is_significant
        if changed:
            angles, converged = smooth_interval(angles, chosen, *known)
        stopwatch.lap("smoothing")
        if config.multistart:
            angles, others = solve_multistart(
                angles, chosen, *known, lambda: stopwatch.lap("smoothing")
            )
            estimated["multistart_frames"] = int(np.count_nonzero(others))
            if others.any():
                angles, converged = smooth_interval(angles, chosen, *known)
            stopwatch.lap("smoothing")
        prediction = separate = NO_MOTION_PREDICTION
        independent = chosen if noise is None else weight_as_independent(chosen, noise)
        if config.lambda_motion > 0.0 and config.motion_prior == "network":
            angles, converged, prediction, separate = self._apply_network(angles, chosen, heads)
        elif config.lambda_motion > 0.0:
            angles, converged, prediction = self._apply_motion_prior(angles, chosen)
            separate = prediction
        stopwatch.lap("smoothing")
        return Solution(angles, converged, chosen, independent, estimated, prediction, separate)

    def _associate(
        self, angles: Float[Array, "T 37"], observations: Observations
    ) -> tuple[Float[Array, "T 37"], Bool[Array, "T"], Observations, bool]:
        """Associate and smooth; whether the smoothed motion changes the association."""
        known, chosen = (self.model, self.config), observations[:]
        choosing = needs_association(observations, self.config)
        if choosing:
            associate(angles, observations, chosen, *known)
        angles, converged = smooth_interval(angles, chosen, *known)
        changed = choosing and associate(angles, observations, chosen, *known) > 0
        return angles, converged, chosen, changed

    def _align(
        self, angles: Float[Array, "T 37"], chosen: Observations
    ) -> tuple[Float[Array, "T 37"], Observations, Alignment]:
        """Alternate between the views' alignment and the motion; the corrected observations."""
        alignment, aligned = Alignment.none(chosen.weights.shape[1]), chosen
        for _ in range(_ALIGNMENT_STEPS):
            alignment = improve(
                alignment, angles, chosen, self.proportions, self.model, self.config
            )
            aligned = alignment.aligned(chosen, forward(self.proportions, angles))
            angles, _ = smooth_interval(angles, aligned, self.model, self.config)
        return angles, aligned, alignment

    def _apply_network(
        self, angles: Float[Array, "T 37"], chosen: Observations, heads: HeadPoses | None
    ) -> tuple[Float[Array, "T 37"], Bool[Array, "T"], MotionPrediction, MotionPrediction]:
        """All frames with the motion network, and its prediction as of independent frames.

        It was learned from detectors that guess hidden joints. Frames in which a joint has no
        detection at all take the Gaussian process's prediction.
        """
        missing = undetected(chosen)
        if missing.all():
            angles, converged, prediction = self._apply_motion_prior(angles, chosen)
        else:
            known = self.model, self.config
            prediction = predict_by_network(angles, chosen, self.proportions, *known, heads)
            start = prediction.mean
            if missing.any():
                other, _, guide = self._apply_motion_prior(angles, chosen)
                prediction = prediction.replaced(guide, missing)
                start = np.where(missing[:, None], other, start)
            angles, converged = smooth_interval(start, chosen, *known, prediction)
        separate = replace(prediction, precision=INDEPENDENT * prediction.precision)
        return angles, converged, prediction, separate

    def _apply_motion_prior(
        self, angles: Float[Array, "T 37"], chosen: Observations
    ) -> tuple[Float[Array, "T 37"], Bool[Array, "T"], MotionPrediction]:
        """All frames with the motion prior.

        Its prediction is linearised about the motion. With `multistart` it is repeated about the
        new motion, and the segments of lower energy are kept.
        """
        known = chosen, self.model, self.config
        prediction = predict_motion(angles, *known)
        angles, converged = smooth_interval(angles, *known, prediction)
        for _ in range(_MAX_PREDICTIONS if self.config.multistart else 0):
            second = predict_motion(angles, *known)
            other, _ = smooth_interval(angles, *known, second)
            best = merge_segments(angles, other, *known)
            changed = changed_frames(angles, best)
            if not changed.any():
                break
            prediction = prediction.replaced(second, changed)
            angles, converged = smooth_interval(best, *known, prediction)
        return angles, converged, prediction
