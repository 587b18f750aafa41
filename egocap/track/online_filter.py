"""The live pass: every frame solved from its past alone, recovering from scratch when lost."""

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
from egocap.pose.solver import solve_frame
from egocap.track.association import can_choose, choose

_WIDENING = (10.0, 3.0)
"""Factors on the robust scale while a pose is sought: far residuals must pull at first."""
_NO_SCATTER = np.zeros(0)
_LIMBS = np.array([
    [LABEL_INDEX[f"{side}_{part}"] for part in parts]
    for side in ("left", "right")
    for parts in (("elbow", "wrist", "hand"), ("knee", "ankle", "foot"))
])  # fmt: skip
_TELLING = 3  # detections of a limb from which its disagreement counts


def track_causally(
    observations: Observations, model: Model, config: TrackerConfig
) -> tuple[Float[Array, "T 37"], Bool[Array, "T"]]:
    """Angles and convergence of every frame, each from the frames before it."""
    return follow(observations, model, config)[:2]


def follow(
    observations: Observations, model: Model, config: TrackerConfig
) -> tuple[Float[Array, "T 37"], Bool[Array, "T"], Observations]:
    """Angles and convergence as `track_causally`, and the places that were taken."""
    follower, taken = Follower(model, config), observations[:]
    angles = np.zeros((len(observations.times), DOF_COUNT))
    converged = np.zeros(len(angles), bool)
    for t in range(len(angles)):
        angles[t], converged[t], frame = follower.step(observations[t : t + 1])
        taken.rays[t], taken.whiten[t] = frame.rays[0], frame.whiten[0]
        taken.weights[t] = frame.weights[0]
    return angles, converged, taken


class Follower:
    """Follows a person one frame at a time, and searches afresh when the track is lost."""

    def __init__(self, model: Model, config: TrackerConfig) -> None:
        self.model, self.config = model, config
        self._past: list[tuple[float, Float[Array, "37"]]] = []  # the last two times and poses
        self._retry = -np.inf

    def step(self, proposed: Observations) -> tuple[Float[Array, "37"], bool, Observations]:
        """Angles of the next frame (T = 1), convergence, and the places that were taken."""
        time, taken = float(proposed.times[0]), proposed[:]
        choosing = can_choose(proposed, self.config)
        angles, converged = np.zeros(DOF_COUNT), False
        frame = _Frame(taken, 0, self.model, self.config)
        if self._past:
            predicted, scatter = self._predict(time)
            if choosing:
                choose(predicted[None], proposed, taken, self.model, self.config)
            angles, converged = frame.solve(predicted, scatter)
        if time >= self._retry and not (self._past and frame.agrees(angles)):
            cost = jump_cost(self.config) if self._past else -np.inf
            angles, converged = frame.search(angles, cost)
            if choosing and choose(angles[None], proposed, taken, self.model, self.config):
                angles, converged = frame.refine(angles)
            if not frame.agrees(angles):
                self._retry = time + self.config.retry_s
        self._past = [*self._past[-1:], (time, angles)]
        return angles, converged, taken

    def _predict(self, time: float) -> tuple[Float[Array, "37"], Float[Array, "37"]]:
        """The pose expected now, and its scatter."""
        (before_time, before), (last_time, last) = self._past[0], self._past[-1]
        step = time - last_time
        # After a pause (dropped frames) the last velocity says nothing.
        fresh = len(self._past) < 2 or step > 2.0 * (last_time - before_time)
        predicted = predict(last, last if fresh else before, self.config.zeta)
        return predicted, self.config.speed * step * SPREAD


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
        self, predicted: Float[Array, "37"], scatter: Float[Array, "37"]
    ) -> tuple[Float[Array, "37"], bool]:
        """Solve with a prediction and its scatter; returns angles and convergence."""
        angles, _, converged, _ = solve_frame(
            self.model, predicted, predicted, scatter, *self.data, float(self.config.robust_scale),
            int(self.config.max_iterations), self.config.tolerance,
        )  # fmt: skip
        return angles, converged

    def search(self, tracked: Float[Array, "37"], cost: float) -> tuple[Float[Array, "37"], bool]:
        """The lowest energy reached from all starting poses; the tracked pose is `cost` ahead."""
        found = [self._minimise(tracked, 1.0)]
        for start in start_poses():
            near = start
            for widening in _WIDENING:
                near = self._minimise(near, widening)[0]
            found.append(self._minimise(near, 1.0))
        angles, energy, converged, _ = min(found, key=lambda result: result[1])
        _, held, _, _ = self._minimise(tracked, 1.0, iterations=0)
        return (angles, converged) if energy + cost < held else (tracked, False)

    def refine(self, angles: Float[Array, "37"]) -> tuple[Float[Array, "37"], bool]:
        """Solve from a pose, without a prediction."""
        refined, _, converged, _ = self._minimise(angles, 1.0)
        return refined, converged

    def agrees(self, angles: Float[Array, "37"]) -> bool:
        """Whether enough of the frame's detections agree with the pose, and half of every limb's.

        A limb in a wrong pose is few among all detections, and nothing else would set it free.
        """
        weights = self.data[3]
        squared = np.empty_like(weights)
        squared_residuals(self.model, angles, *self.data, squared)
        there, close = weights > 0.0, squared < self.config.agreement**2
        if np.count_nonzero(close) < self.config.lost_share * np.count_nonzero(there):
            return False
        seen, agreeing = there[:, _LIMBS].sum((0, 2)), close[:, _LIMBS].sum((0, 2))
        return not np.any((seen >= _TELLING) & (2 * agreeing < seen))

    def _minimise(
        self, start: Float[Array, "37"], widening: float, iterations: int | None = None
    ) -> tuple[Float[Array, "37"], float, bool, int]:
        """Solve without a prediction; returns angles, energy, converged, steps."""
        steps = int(self.config.max_iterations) if iterations is None else iterations
        return solve_frame(
            self.model, start, start, _NO_SCATTER, *self.data,
            widening * self.config.robust_scale, steps, self.config.tolerance,
        )  # fmt: skip


def track_both_ways(
    observations: Observations, model: Model, config: TrackerConfig
) -> tuple[Float[Array, "T 37"], Bool[Array, "T"]]:
    """The better of a forward and a backward pass in every frame.

    What the forward pass loses until it recovers, the backward pass has from the other side.
    """
    forward, forward_done, there = follow(observations, model, config)
    backward, backward_done, back = follow(observations.reversed, model, config)
    takes = there, back.reversed
    both = np.stack([forward, backward[::-1]])
    done = np.stack([forward_done, backward_done[::-1]])
    energies = np.stack([
        frame_energies(a, taken, model, config) for a, taken in zip(both, takes, strict=True)
    ])  # fmt: skip
    choice = cheapest_path(energies, jump_cost(config))
    frames = np.arange(len(choice))
    return both[choice, frames], done[choice, frames]


def jump_cost(config: TrackerConfig) -> float:
    """Energy that leaving a continuous motion must save: so many wholly wrong detections."""
    return config.jump_gain * 0.5 * config.lambda_detection * config.robust_scale**2


def cheapest_path(costs: Float[Array, "S T"], change: float) -> Int[Array, "T"]:
    """Choose one of S states in each of T frames at the least sum of costs and of changes.

    Source: Viterbi 1967, with the same price for every change of state.
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
        data = observations.centres, observations.rays[t], observations.whiten[t]
        energies[t, 0] = detections(
            model, pose, *data, observations.weights[t], float(config.robust_scale), H, g
        )
        energies[t, 1] = priors(model, pose, H, g)
    if len(angles) > 2:
        stencil = acceleration_stencil(observations.times)[:-2]
        parts = [stencil[:, k, None] * angles[k : len(angles) - 2 + k] for k in range(3)]
        pushed = np.sum(parts, 0) / (config.acceleration * AGILITY)
        energies[2:, 2] = pseudo_huber(pushed).sum(1)
    return energies
