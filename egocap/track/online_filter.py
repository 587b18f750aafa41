"""The online filter: every frame solved given its past, and initialised again when lost."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from egocap.body.labels import LABEL_INDEX
from egocap.body.skeleton import AGILITY, DOF_COUNT, SPREAD
from egocap.pose.config import TrackerConfig
from egocap.pose.energy import acceleration_stencil, predict, pseudo_huber
from egocap.pose.initial_poses import start_poses
from egocap.pose.kernel import Model, detections, priors, squared_residuals
from egocap.pose.observations import Observations
from egocap.pose.solver import NO_PREDICTION, Prediction, solve_frame
from egocap.track.association import associate, needs_association

_SEARCH_SCALES = (10.0, 3.0)
"""Factors on the robust scale while a pose is searched: large residuals must count at first."""
_LIMBS = np.array([
    [LABEL_INDEX[f"{side}_{part}"] for part in parts]
    for side in ("left", "right")
    for parts in (("elbow", "wrist", "hand"), ("knee", "ankle", "foot"))
])  # fmt: skip
_MIN_LIMB_DETECTIONS = 3  # of one limb in all views, to test its inlier ratio


def filter_sequence(
    observations: Observations, model: Model, config: TrackerConfig
) -> tuple[Float[Array, "T 37"], Bool[Array, "T"], Observations]:
    """Angles and convergence of every frame given its past, and the detections chosen."""
    online, chosen = OnlineFilter(model, config), observations[:]
    angles = np.zeros((len(observations.times), DOF_COUNT))
    converged = np.zeros(len(angles), bool)
    for t in range(len(angles)):
        angles[t], converged[t], frame = online.step(observations[t : t + 1])
        chosen.rays[t], chosen.whiten[t] = frame.rays[0], frame.whiten[0]
        chosen.weights[t] = frame.weights[0]
    return angles, converged, chosen


class OnlineFilter:
    """Solves one frame after another."""

    def __init__(self, model: Model, config: TrackerConfig) -> None:
        self.model, self.config = model, config
        self._past: list[tuple[float, Float[Array, "37"]]] = []  # the last two times and poses
        self._reinit_time = -np.inf

    def step(self, proposed: Observations) -> tuple[Float[Array, "37"], bool, Observations]:
        """Angles of the next frame (T = 1), convergence, and the detections chosen."""
        time, chosen = float(proposed.times[0]), proposed[:]
        choosing = needs_association(proposed, self.config)
        angles, converged = np.zeros(DOF_COUNT), False
        frame = _FrameSolver(chosen, self.model, self.config)
        if self._past:
            prediction = self._predict(time)
            if choosing:
                associate(prediction.mean[None], proposed, chosen, self.model, self.config)
            angles, _, converged, _ = frame.solve(prediction.mean, prediction)
        if time >= self._reinit_time and not (self._past and frame.fits(angles)):
            cost = jump_cost(self.config) if self._past else -np.inf
            angles, converged = frame.search(angles, cost)
            if choosing and associate(angles[None], proposed, chosen, self.model, self.config):
                angles, _, converged, _ = frame.solve(angles)
            if not frame.fits(angles):
                self._reinit_time = time + self.config.reinit_interval_s
        self._past = [*self._past[-1:], (time, angles)]
        return angles, converged, chosen

    def _predict(self, time: float) -> Prediction:
        (before_time, before), (last_time, last) = self._past[0], self._past[-1]
        step = time - last_time
        # The last velocity does not hold after dropped frames.
        gap = len(self._past) < 2 or step > 2.0 * (last_time - before_time)
        predicted = predict(last, last if gap else before, self.config.zeta)
        return Prediction(predicted, self.config.velocity_sigma * step * SPREAD)


class _FrameSolver:
    """Solves one frame of detections."""

    def __init__(self, observations: Observations, model: Model, config: TrackerConfig) -> None:
        self.seen, self.model, self.config = observations.frame(0), model, config

    def solve(
        self, start: Float[Array, "37"], prediction: Prediction = NO_PREDICTION,
        scale_factor: float = 1.0, iterations: int | None = None,
    ) -> tuple[Float[Array, "37"], float, bool, int]:  # fmt: skip
        """Angles, energy, converged, steps."""
        steps = self.config.max_iterations if iterations is None else iterations
        return solve_frame(
            self.model, start, prediction, self.seen,
            float(scale_factor * self.config.robust_scale), int(steps),
            float(self.config.tolerance),
        )  # fmt: skip

    def search(self, tracked: Float[Array, "37"], cost: float) -> tuple[Float[Array, "37"], bool]:
        """The best result from all initial poses; leaving the tracked pose costs `cost`."""
        found = [self.solve(tracked)]
        for start in start_poses():
            pose = start
            for factor in _SEARCH_SCALES:
                pose = self.solve(pose, scale_factor=factor)[0]
            found.append(self.solve(pose))
        angles, energy, converged, _ = min(found, key=lambda result: result[1])
        _, tracked_energy, _, _ = self.solve(tracked, iterations=0)
        return (angles, converged) if energy + cost < tracked_energy else (tracked, False)

    def fits(self, angles: Float[Array, "37"]) -> bool:
        """Whether enough of the frame's detections are inliers, and half of every limb's."""
        weights = self.seen.weights
        squared = np.empty_like(weights)
        squared_residuals(self.model, angles, self.seen, squared)
        valid, inlier = weights > 0.0, squared < self.config.inlier_threshold**2
        if np.count_nonzero(inlier) < self.config.min_inlier_ratio * np.count_nonzero(valid):
            return False
        of_limbs, inliers = valid[:, _LIMBS].sum((0, 2)), inlier[:, _LIMBS].sum((0, 2))
        return not np.any((of_limbs >= _MIN_LIMB_DETECTIONS) & (2 * inliers < of_limbs))


def filter_both_ways(
    observations: Observations, model: Model, config: TrackerConfig
) -> tuple[Float[Array, "T 37"], Bool[Array, "T"]]:
    """Angles and convergence: in every frame the better of a forward and a backward pass."""
    forward, forward_done, chosen = filter_sequence(observations, model, config)
    backward, backward_done, back = filter_sequence(observations.reversed, model, config)
    both = np.stack([forward, backward[::-1]])
    done = np.stack([forward_done, backward_done[::-1]])
    energies = np.stack([
        frame_energies(angles, seen, model, config)
        for angles, seen in zip(both, (chosen, back.reversed), strict=True)
    ])  # fmt: skip
    path = cheapest_path(energies, jump_cost(config))
    frames = np.arange(len(path))
    return both[path, frames], done[path, frames]


def jump_cost(config: TrackerConfig) -> float:
    """Energy that leaving a continuous motion must save: that of `reinit_gain` outliers."""
    return config.reinit_gain * 0.5 * config.lambda_detection * config.robust_scale**2


def cheapest_path(costs: Float[Array, "S T"], change: float) -> Int[Array, "T"]:
    """The states, one of S in each of T frames, of the least sum of costs and of changes.

    Source: Viterbi 1967, with the same cost for every change of state.
    """
    states, frames = costs.shape
    total, came_from = costs[:, 0].copy(), np.zeros((states, frames), int)
    for t in range(1, frames):
        best = int(np.argmin(total))
        stay = total <= total[best] + change
        came_from[:, t] = np.where(stay, np.arange(states), best)
        total = np.where(stay, total, total[best] + change) + costs[:, t]
    path = np.zeros(frames, int)
    path[-1] = int(np.argmin(total))
    for t in range(frames - 1, 0, -1):
        path[t - 1] = came_from[path[t], t]
    return path


def frame_energies(
    angles: Float[Array, "T 37"], observations: Observations, model: Model, config: TrackerConfig
) -> Float[Array, "T"]:
    """Energy of every frame on its own: detections, limits, pose prior."""
    return term_energies(angles, observations, model, config)[:, :2].sum(1)


def term_energies(
    angles: Float[Array, "T 37"], observations: Observations, model: Model, config: TrackerConfig
) -> Float[Array, "T 4"]:
    """Energy of every frame by term (`egocap.data.track.ENERGY_TERMS`).

    Smoothness is that of the accelerations which end in the frame.
    """
    energies = np.zeros((len(angles), 4))
    H, g = np.zeros((DOF_COUNT, DOF_COUNT)), np.zeros(DOF_COUNT)
    for t, pose in enumerate(np.ascontiguousarray(angles)):
        seen = observations.frame(t)
        energies[t, 0] = detections(model, pose, seen, float(config.robust_scale), H, g)
        energies[t, 1] = priors(model, pose, H, g)
    if len(angles) > 2:
        stencil = acceleration_stencil(observations.times)[:-2]
        parts = [stencil[:, k, None] * angles[k : len(angles) - 2 + k] for k in range(3)]
        accelerations = np.sum(parts, 0) / (config.acceleration_sigma * AGILITY)
        energies[2:, 2] = pseudo_huber(accelerations).sum(1)
    return energies
