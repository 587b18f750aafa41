"""Fixed-lag smoother: detections frame by frame in, the pose of a moment ago out.

The last frames are solved together, with the interval smoother's energy; the frames before them are
a Gaussian over the first two, marginalised out one by one. Every new frame moves the window and
takes a few Gauss-Newton steps: first with detections alone, then with the motion network's
prediction as well. Limbs that the window has lost are recovered from other starts: the window's own
solution by graduated non-convexity, and the poses of the causal filter, which runs beside.

Source: Moore 1973, "Discrete fixed-lag smoothing algorithms", Automatica 9; Sibley, Matthies &
Sukhatme 2010, "Sliding window filter with application to planetary landing", J. Field Robotics 27.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.proportions import Proportions
from egocap.body.skeleton import AGILITY, DOF_COUNT, SPREAD
from egocap.data.head_pose import HeadPoses
from egocap.pose.banded import add_block, add_quadratic, banded_inverse, eliminate
from egocap.pose.config import TrackerConfig
from egocap.pose.energy import acceleration_stencil
from egocap.pose.kernel import Model, information
from egocap.pose.motion_network import correct_track, network_precision
from egocap.pose.motion_prior import NO_MOTION_PREDICTION, MotionPrediction
from egocap.pose.observations import Observations, joined
from egocap.track.association import associate, needs_association
from egocap.track.motion_prediction import INDEPENDENT, undetected
from egocap.track.online_filter import OnlineFilter
from egocap.track.smoother import (
    BandedSystem,
    Minimum,
    accelerations,
    interval_energy,
    minimise,
)
from egocap.track.uncertainty import joint_deviations

WINDOW, WINDOW_S = 6, 0.18
"""Frames solved together, at least, and seconds that they span; with a long lag, as many as it
needs."""
_FULL_S, _EXPONENT = 1.0 / 30.0, 0.5
"""Time since the last frame from which a frame's detections count fully, and the exponent of the
fraction of it below: errors of detectors persist, so that a higher rate tells less a frame."""
_ACCELERATION = 2.0
"""Factor on the accelerations' deviation: the interval smoother gives detections half the weight.
Chosen on validation clips."""
_STEPS, _RESTART_STEPS = 2, 3  # Gauss-Newton, of a frame and of another start
_RESTART_S = 0.1
"""Time between attempts from other starts."""
_WIDER = (10.0, 3.0)
"""Factors on the robust scale, one after another, of an attempt from the window's own solution."""
_LEAVE, _MIN_GAIN = 9.0, 3.0
"""Energy that the former must save, as it leaves the past behind (two outliers'), and the latter.
"""
_KEPT_VELOCITY = 0.8  # of the motion from frame to frame, at the start of a new one
_MEMORY_S = 0.8
"""Time before the window that the motion network is told."""
_HELD = 1.0
"""Standard deviation of poses in the dark about the filter's, in each angle's prior deviation."""
_PAIR = 2 * DOF_COUNT
_UNKNOWN = np.zeros((DOF_COUNT, DOF_COUNT))
_HOLD = np.diag((_HELD * SPREAD) ** -2.0)


@dataclass(frozen=True, eq=False)
class LaggedPose:
    """The pose of one frame, given the frames up to some later one.

    The covariance is that given the frames up to this one: a detector's errors persist from frame
    to frame, so that a lag's frames add little to what is known.
    """

    time: float  # s
    angles: Float[Array, "37"]
    covariance: Float[Array, "37 37"]  # rad^2
    converged: bool
    chosen: Observations  # T = 1: the detections as associated
    T_world_head: Float[Array, "4 4"] | None  # as given


@dataclass(frozen=True, eq=False)
class Past:
    """What earlier frames say of the first two of a window: a Gaussian in information form.

    The energy of a departure d from `mean` is d (A d / 2 + gradient), A the band's matrix.
    """

    mean: Float[Array, "2 37"]
    bands: Float[Array, "75 74"]
    gradient: Float[Array, "74"]

    def add(
        self, angles: Float[Array, "T 37"], bands: Float[Array, "75 N"],
        gradient: Float[Array, "N"],
    ) -> float:  # fmt: skip
        """Add its terms to a window's banded system; their energy."""
        off = (angles[:2] - self.mean).ravel()
        return add_quadratic(self.bands, self.gradient, off, bands, gradient)


def marginalise(
    past: Past | None, angles: Float[Array, "3 37"], observations: Observations, model: Model,
    config: TrackerConfig,
) -> Past:  # fmt: skip
    """What `past` and the first of three frames say of the other two (Schur complement).

    The terms are linearised at `angles`; `observations` are those of the three frames.
    """
    n = DOF_COUNT
    bands, g = np.zeros((_PAIR + 1, 3 * n), order="F"), np.zeros(3 * n)
    accelerations(np.ascontiguousarray(angles), acceleration_stencil(observations.times),
                  config.acceleration_sigma * AGILITY, bands, g)  # fmt: skip
    if past is not None:
        past.add(angles, bands, g)
    own, pull = information(model, angles[0], observations.frame(0), config.robust_scale)
    add_block(own, pull, 0, bands, g)
    if not eliminate(bands, g, n):
        raise np.linalg.LinAlgError("a frame's information is not positive definite")
    return Past(angles[1:].copy(), bands[:, n:].copy(order="F"), g[n:].copy())


@dataclass(eq=False)
class _Frame:
    """A frame and what the last window that held it found."""

    proposed: Observations
    chosen: Observations
    filtered: Float[Array, "37"]  # angles by the causal filter
    angles: Float[Array, "37"]  # by detections alone
    motion: Float[Array, "37"]  # with the motion prior
    T_world_head: Float[Array, "4 4"] | None
    covariance: Float[Array, "37 37"] = field(default_factory=lambda: _UNKNOWN)  # when newest
    std: Float[Array, "18"] = field(default_factory=lambda: _UNKNOWN[0, :0])  # of the joints, m
    precision: Float[Array, "37 37"] = field(default_factory=lambda: _UNKNOWN)  # the prior's, too
    settled: bool = False

    @property
    def time(self) -> float:
        return float(self.chosen.times[0])

    def pose(self) -> LaggedPose:
        covariance = self.covariance
        if self.precision.any():
            covariance = np.linalg.inv(np.linalg.inv(covariance) + INDEPENDENT * self.precision)
        return LaggedPose(self.time, self.motion, covariance, self.settled, self.chosen,
                          self.T_world_head)  # fmt: skip


class FixedLagSmoother:
    """Solves the last frames again with every new one. Not to be shared between threads."""

    def __init__(self, proportions: Proportions, model: Model, config: TrackerConfig) -> None:
        factor = _ACCELERATION * config.acceleration_sigma
        self.proportions, self.model = proportions, model
        self.config = replace(config, acceleration_sigma=factor)
        self._configs = {
            factor: replace(self.config, robust_scale=factor * config.robust_scale)
            for factor in (1.0, *_WIDER)
        }
        self._filter = OnlineFilter(model, config)
        self._past: Past | None = None
        self._before: list[_Frame] = []  # the window, as the motion network is told
        self._window: list[_Frame] = []
        self._given = self._tried = -np.inf

    def step(
        self, proposed: Observations, T_world_head: Float[Array, "4 4"] | None = None
    ) -> list[LaggedPose]:
        """The poses that are due with the next frame (T = 1): at an even rate, one.

        None at the start; several where the frame rate falls. The motion prior uses the head poses.
        """
        self._append(self._weighted(proposed), T_world_head)
        self._solve()
        due = self._due()
        if due:
            self._given = due[-1].time
        self._forget()
        return [frame.pose() for frame in due]

    def finish(self) -> list[LaggedPose]:
        """The poses that the lag withheld, given all frames."""
        rest = [frame.pose() for frame in self._window if frame.time > self._given]
        self._given = np.inf
        return rest

    def _weighted(self, proposed: Observations) -> Observations:
        """The detections of a frame with weights for the time since the last one."""
        if not self._window:
            return proposed
        elapsed = float(proposed.times[0]) - self._window[-1].time
        return proposed.weighted(min(elapsed / _FULL_S, 1.0) ** _EXPONENT)

    def _append(self, proposed: Observations, T_world_head: Float[Array, "4 4"] | None) -> None:
        filtered, _, chosen = self._filter.step(proposed)
        angles = filtered
        if self._window:
            angles, chosen = self._extrapolate(float(proposed.times[0])), proposed[:]
            if needs_association(proposed, self.config):
                associate(angles[None], proposed, chosen, self.model, self.config)
        chosen = replace(chosen, modes=None)
        self._window.append(_Frame(proposed, chosen, filtered, angles, angles, T_world_head))

    def _extrapolate(self, time: float) -> Float[Array, "37"]:
        """The pose at a time after the window's, from its last two."""
        last, before = self._window[-1], self._window[-min(len(self._window), 2)]
        step = last.time - before.time
        if not 0.0 < time - last.time < 2.0 * step:
            return last.angles
        kept = _KEPT_VELOCITY * (time - last.time) / step
        return last.angles + kept * (last.angles - before.angles)

    def _solve(self) -> None:
        """Solve the window by detections, then with the motion prior."""
        window = self._window
        seen = joined([frame.chosen for frame in window])
        held = self._held(seen)
        found = self._minimised(
            np.array([f.angles for f in window]), seen, _STEPS, held, self._past
        )
        if self.config.multistart and window[-1].time >= self._tried + _RESTART_S:
            self._tried = window[-1].time
            found, seen = self._restarted(found, seen, held)
        covariances = banded_inverse(found.system[1], DOF_COUNT)
        std = joint_deviations(
            self.proportions, found.states, covariances, self.config.model_error_m
        )
        for t, frame in enumerate(window):
            frame.angles, frame.std = found.states[t], std[t]
        window[-1].covariance = covariances[-1]
        if self.config.lambda_motion > 0.0:
            found = self._apply_motion_prior(seen, held)
        for t, frame in enumerate(window):
            frame.motion, frame.settled = found.states[t], bool(found.converged[t])

    def _restarted(
        self, found: Minimum, seen: Observations, held: MotionPrediction
    ) -> tuple[Minimum, Observations]:
        """The window's solution and detections, from another start if that saves energy.

        The starts are the solution itself, with a wider robust scale so that detections count which
        contradict it, and the filter's poses. The former leaves the past behind: a limb that was
        believed to be elsewhere has a smooth past there.
        """
        alone = other = self._minimised(found.states, seen, 0, held, None)
        for factor in (*_WIDER, 1.0):
            other = self._minimised(other.states, seen, _RESTART_STEPS, held, None, factor)
        if alone.system[0] - other.system[0] >= _LEAVE:
            found, self._past = other, None
        start = np.array([frame.filtered for frame in self._window])
        chosen = [replace(frame.proposed[:], modes=None) for frame in self._window]
        for pose, frame, detected in zip(start, self._window, chosen, strict=True):
            if needs_association(frame.proposed, self.config):
                associate(pose[None], frame.proposed, detected, self.model, self.config)
        others = joined(chosen)
        other = self._minimised(start, others, _RESTART_STEPS, held, self._past)
        if found.system[0] - other.system[0] < _MIN_GAIN:
            return found, seen
        for frame, detected in zip(self._window, chosen, strict=True):
            frame.chosen = detected
        return other, others

    def _held(self, seen: Observations) -> MotionPrediction:
        """In the dark, frames without any detection, the filter's pose, which comes to rest."""
        dark = ~np.any(seen.weights > 0.0, axis=(1, 2))
        if not dark.any():
            return NO_MOTION_PREDICTION
        mean = np.array([frame.filtered for frame in self._window])
        return MotionPrediction(mean, dark[:, None, None] * _HOLD)

    def _apply_motion_prior(self, seen: Observations, held: MotionPrediction) -> Minimum:
        """The window's motion with the network's prediction.

        The network was learned from detectors that guess hidden joints: there is no prediction for
        frames in which a joint has no detection at all.
        """
        told = [*self._before, *self._window]
        mean, spread = correct_track(
            np.array([f.time for f in told]), np.array([f.angles for f in told]),
            np.array([f.std for f in told]), self.proportions,
            HeadPoses.of([f.T_world_head for f in told]),
        )  # fmt: skip
        here = slice(len(self._before), None)
        precision = network_precision(spread[here])
        missing = undetected(seen)
        precision[missing] = held.precision[missing] if len(held.mean) else 0.0
        mean[here][missing] = held.mean[missing] if len(held.mean) else mean[here][missing]
        self._window[-1].precision = precision[-1]
        start = np.array([*(f.motion for f in self._window[:-1]), mean[-1]])
        return self._minimised(
            start, seen, _STEPS, MotionPrediction(mean[here], precision), self._past
        )

    def _minimised(
        self, start: Float[Array, "T 37"], seen: Observations, steps: int,
        prediction: MotionPrediction, past: Past | None, factor: float = 1.0,
    ) -> Minimum:  # fmt: skip
        """The window's solution: the interval smoother's energy, with what the past says.

        `factor` is one on the robust scale: 1, or of `_WIDER`.
        """
        of_window = interval_energy(seen, self.model, self._configs[factor], prediction)

        def system(angles: Float[Array, "T 37"]) -> BandedSystem:
            energy, bands, gradient = of_window(angles)
            if past is not None:
                energy += past.add(angles, bands, gradient)
            return energy, bands, gradient

        return minimise(start, system, steps, self.config.tolerance)

    def _due(self) -> list[_Frame]:
        """Frames not given yet, up to that nearest to the lag before the newest."""
        newest, lag = self._window[-1].time, self.config.lag
        spacing = newest - self._window[-2].time if len(self._window) > 1 else 0.0
        last = newest - lag + 0.5 * min(spacing, lag)
        return [frame for frame in self._window if self._given < frame.time <= last]

    def _forget(self) -> None:
        """Marginalise the frames beyond the window that were given."""
        window = self._window
        last = min(self._given, window[-1].time - WINDOW_S)
        while len(window) > WINDOW and window[0].time <= last:
            first = window[:3]
            self._past = marginalise(
                self._past, np.array([frame.angles for frame in first]),
                joined([frame.chosen for frame in first]), self.model, self.config,
            )  # fmt: skip
            self._before.append(window.pop(0))
        since = window[0].time - _MEMORY_S
        self._before = [frame for frame in self._before if frame.time >= since]


def smooth_fixed_lag(
    observations: Observations, proportions: Proportions, model: Model, config: TrackerConfig,
    heads: HeadPoses | None = None,
) -> list[LaggedPose]:  # fmt: skip
    """The poses of all frames of a recording, each given those up to the lag after it."""
    smoother = FixedLagSmoother(proportions, model, config)
    poses = []
    for t in range(len(observations.times)):
        T_world_head = heads.T_world_head[t] if heads is not None and heads.known[t] else None
        poses.append(smoother.step(observations[t : t + 1], T_world_head))
    return [*chain.from_iterable(poses), *smoother.finish()]
