"""Bundle adjustment of many poses and what they share: the energy, derivatives, and its minimum.

    E(c, p_1 .. p_T) = sum_t E_frame(p_t, c) + (c - m)^T S^-1 (c - m) / 2

Shared are the components of the body and, in `egocap.fitting.mount`, the pose of the rig. The
joints are linear in the components, so that their derivatives are closed: column k is the pose of a
body that has component k alone. Poses are eliminated frame by frame (Schur
complement), so that a step costs no more than its frames. What is left at the minimum is the
information about the body with all poses free; its inverse is the posterior covariance.

Source: Triggs et al. 2000, "Bundle adjustment - a modern synthesis", section 6.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from egocap.body.skeleton import (
    AXES,
    DOF_COUNT,
    DOF_JOINT,
    JOINTS,
    LABEL_POINTS,
    LIMITS,
    MOVES,
    POINT_COUNT,
    POINT_PARENTS,
    SPREAD,
)
from egocap.fitting.body_prior import BASIS, rest_offsets
from egocap.fitting.config import FitConfig
from egocap.geometry import axis_angle
from egocap.pose.config import TrackerConfig
from egocap.pose.observations import Observations
from egocap.pose.pose_prior import load_posture

MARGINAL = 0.125
"""Share of log det of the poses' Gauss-Newton matrix that counts. It would be 1/2 of the true
Hessian, which is linear in the length of a bone that turns towards a measured end, where the other
is quadratic: 1/4. Half of that is left where the priors hold the poses as well: so it came out on
simulated people, with 1/4 short by as much as without it long."""
CREDIBLE = 3.0
"""Longest correction of the bias, in posterior standard deviations: one Newton step does not hold
farther. With a single camera it would be ten, and took centimetres from every limb."""
_NUDGE = 2e-4  # metres, of differences


class GaussianPrior(Protocol):
    """Mean and covariance of the shared parameters."""

    @property
    def mean(self) -> Float[Array, "K"]: ...

    @property
    def covariance(self) -> Float[Array, "K K"]: ...


@dataclass(frozen=True, eq=False)
class FitProblem:
    """Observations, prior and settings of a fit. Subclasses share more than the body."""

    observations: Observations
    prior: GaussianPrior
    config: TrackerConfig

    @cached_property
    def precision(self) -> Float[Array, "K K"]:
        return np.linalg.inv(self.prior.covariance)

    def joints(self, shared: Float[Array, "K"], poses: Float[Array, "T 37"]) -> Joints:
        """Labelled joints in the frame of the observations, and their derivatives."""
        return Joints(*joint_derivatives(shared, poses))

    def further(
        self, shared: Float[Array, "K"], poses: Float[Array, "T 37"], system: FitSystem
    ) -> float:
        """Energy of further terms; their derivatives are added to `system`."""
        return 0.0


class Joints(NamedTuple):
    """Labelled joints and their derivatives by the angles and by what is shared."""

    labels: Float[Array, "T 18 3"]
    by_angle: Float[Array, "T 18 3 37"]
    by_shared: Float[Array, "T 18 3 K"]


@dataclass(frozen=True, eq=False)
class FitSystem:
    """Energy, gradient and Gauss-Newton blocks at a point; body: all that is shared."""

    energy: float
    g_pose: Float[Array, "T 37"]
    g_body: Float[Array, "K"]
    pose: Float[Array, "T 37 37"]
    cross: Float[Array, "T 37 K"]
    body: Float[Array, "K K"]
    squared: Float[Array, "T V 18"]  # residuals, in variances


def select_frames(observations: Observations, frames: Int[Array, "F"]) -> Observations:
    times, rays, whiten, weights = (
        getattr(observations, n)[frames] for n in ("times", "rays", "whiten", "weights")
    )
    return Observations(times, observations.centres, rays, whiten, weights)


def solve(
    problem: FitProblem,
    poses: Float[Array, "T 37"],
    components: Float[Array, "K"],
    config: FitConfig,
) -> tuple[Float[Array, "T 37"], Float[Array, "K"], bool]:
    """Levenberg-Marquardt over poses and body."""
    system, damping = linearised(problem, poses, components), 1e-3
    for _ in range(config.iterations):
        step_poses, step_body = _step(system, damping)
        trial_poses, trial_body = poses + step_poses, components + step_body
        trial = linearised(problem, trial_poses, trial_body)
        if trial.energy < system.energy:
            gain = system.energy - trial.energy
            poses, components, system = trial_poses, trial_body, trial
            damping = max(0.2 * damping, 1e-7)
            if gain < config.tolerance * abs(system.energy):
                return poses, components, True
        else:
            damping *= 10.0
            if damping > 1e6:
                return poses, components, True
    return poses, components, False


def _step(system: FitSystem, damping: float) -> tuple[Float[Array, "T 37"], Float[Array, "K"]]:
    pose, body = _damped(system.pose, damping), _damped(system.body, damping)
    inner = np.linalg.solve(pose, np.concatenate([system.cross, system.g_pose[..., None]], -1))
    back, shift = inner[..., :-1], inner[..., -1]  # (T, 37, K), (T, 37)
    schur = body - np.einsum("tdk,tdl->kl", system.cross, back)
    right = system.g_body - np.einsum("tdk,td->k", system.cross, shift)
    step_body = -np.linalg.solve(schur, right)
    step_poses = -shift - back @ step_body
    longest = max(np.abs(step_poses).max(), 1e-12)
    shrink = min(1.0, 0.5 / longest)  # the linearisation does not hold farther
    return shrink * step_poses, shrink * step_body


def _damped(H: Float[Array, "*T N N"], damping: float) -> Float[Array, "*T N N"]:
    N = H.shape[-1]
    return H * (1.0 + damping * np.eye(N)) + 1e-9 * np.eye(N)


def information(system: FitSystem) -> Float[Array, "K K"]:
    """About the body, all poses being free."""
    back = np.linalg.solve(_damped(system.pose, 0.0), system.cross)
    return system.body - np.einsum("tdk,tdl->kl", system.cross, back)


def without_bias(
    problem: FitProblem, poses: Float[Array, "T 37"], components: Float[Array, "K"]
) -> tuple[Float[Array, "T 37"], Float[Array, "K"]]:
    """Correct the bias of what is shared that comes from free poses.

    A bone whose direction is found anew from noise in every frame comes out too long, as the end of
    a noisy vector lies outside the circle it should be on: Neyman and Scott's problem. Marginal
    over the poses (Laplace), the energy of a body has log det(H_pp) / 2 besides; one Newton step of
    at most `CREDIBLE` is made for the share `MARGINAL` of log det of the Gauss-Newton form.
    """
    system = linearised(problem, poses, components)
    back = np.linalg.solve(_damped(system.pose, 0.0), system.cross)
    held = _prior_curvature(problem, poses)
    slope = np.zeros(len(components))
    for k in range(len(components)):
        ends = [
            _log_volume(
                problem, poses - sign * _NUDGE * back[..., k], components + sign * nudge, held
            )
            for nudge in [_NUDGE * np.eye(len(components))[k]]
            for sign in (1.0, -1.0)
        ]
        slope[k] = (ends[0] - ends[1]) / (2.0 * _NUDGE)
    known = information(system)
    step = -np.linalg.solve(known, MARGINAL * slope)
    step *= min(1.0, CREDIBLE / max(np.sqrt(step @ known @ step), 1e-12))
    return poses - back @ step, components + step


def _log_volume(
    problem: FitProblem,
    poses: Float[Array, "T 37"],
    components: Float[Array, "K"],
    held: Float[Array, "T 37 37"],
) -> float:
    """Sum of log det H_pp, with the given prior part, which is discontinuous at the limits."""
    own = linearised(problem, poses, components).pose - _prior_curvature(problem, poses)
    return float(np.linalg.slogdet(_damped(own + held, 0.0))[1].sum())


def _prior_curvature(problem: FitProblem, poses: Float[Array, "T 37"]) -> Float[Array, "T 37 37"]:
    H = np.zeros((len(poses), DOF_COUNT, DOF_COUNT))
    _pose_priors(poses, problem.config, np.zeros_like(poses), H)
    return H


def linearised(
    problem: FitProblem, poses: Float[Array, "T 37"], components: Float[Array, "K"]
) -> FitSystem:
    seen, config = problem.observations, problem.config
    labels, by_angle, by_body = problem.joints(components, poses)
    away = labels[:, None] - seen.centres[:, None]  # (T, V, 18, 3)
    distance = np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-6)
    direction = away / distance
    towards = np.maximum(1.0 + (seen.rays * direction).sum(-1), 1e-6)[..., None]
    residual = 2.0 * np.einsum("tvlij,tvlj->tvli", seen.whiten, direction) / towards
    squared = (residual**2).sum(-1)
    scale = config.robust_scale**2
    share = scale / (squared + scale)
    energy = 0.5 * float((seen.weights * squared * share).sum())
    w = seen.weights * share**2
    B = (2.0 * seen.whiten - residual[..., None] * seen.rays[..., None, :]) / towards[..., None]
    along = np.einsum("tvlij,tvlj->tvli", B, direction)[..., None]
    B = (B - along * direction[..., None, :]) / distance[..., None]  # residual by joint, (.., 2, 3)
    weighted = w[..., None, None] * B
    pull = np.einsum("tvlij,tvli->tlj", weighted, residual)
    weight = (np.swapaxes(weighted, -1, -2) @ B).sum(1)  # (T, 18, 3, 3)
    flat_angle, flat_body = (J.reshape(len(J), -1, J.shape[-1]) for J in (by_angle, by_body))
    by_weight = (weight @ by_angle).reshape(flat_angle.shape)
    pose = np.swapaxes(flat_angle, 1, 2) @ by_weight
    cross = np.swapaxes(by_weight, 1, 2) @ flat_body
    body = np.tensordot(by_body, weight @ by_body, ((0, 1, 2), (0, 1, 2))) + problem.precision
    g_pose = np.einsum("tljd,tlj->td", by_angle, pull)
    departure = components - problem.prior.mean
    g_body = np.einsum("tljk,tlj->k", by_body, pull) + problem.precision @ departure
    energy += 0.5 * float(departure @ problem.precision @ departure)
    energy += _pose_priors(poses, config, g_pose, pose)
    system = FitSystem(energy, g_pose, g_body, pose, cross, body, squared)
    return replace(system, energy=energy + problem.further(components, poses, system))


def _pose_priors(
    poses: Float[Array, "T 37"],
    config: TrackerConfig,
    gradient: Float[Array, "T 37"],
    H: Float[Array, "T 37 37"],
) -> float:
    """Limits, rest pose and everyday postures, as `egocap.pose.energy` has them; adds to both."""
    posture, own = load_posture(), np.arange(DOF_COUNT)
    beyond = np.maximum(poses - LIMITS[:, 1], 0.0) - np.maximum(LIMITS[:, 0] - poses, 0.0)
    root = np.sqrt(1.0 + (poses / SPREAD) ** 2)
    away = poses - posture.mean
    pull = config.lambda_posture * away @ posture.precision
    gradient += 2.0 * config.lambda_limit * beyond + pull
    gradient += config.lambda_pose * poses / root / SPREAD**2
    H[:, own, own] += 2.0 * config.lambda_limit * (beyond != 0.0)
    H[:, own, own] += config.lambda_pose / root / SPREAD**2
    H += config.lambda_posture * posture.precision
    energy = config.lambda_limit * (beyond**2).sum() + config.lambda_pose * (root - 1.0).sum()
    return float(energy + 0.5 * (pull * away).sum())


def joint_derivatives(
    components: Float[Array, "K"], angles: Float[Array, "T 37"]
) -> tuple[Float[Array, "T 18 3"], Float[Array, "T 18 3 37"], Float[Array, "T 18 3 K"]]:
    """Labelled joints in the head frame, their derivatives by the angles and by the components."""
    T, labels = len(angles), list(LABEL_POINTS)
    offsets = rest_offsets(components)
    where, by_body = np.zeros((T, POINT_COUNT, 3)), np.zeros((T, POINT_COUNT, 3, len(components)))
    axes, rotations = np.zeros((T, DOF_COUNT, 3)), []
    for i, parent in enumerate(POINT_PARENTS):
        R = np.broadcast_to(np.eye(3), (T, 3, 3)) if parent < 0 else rotations[parent]
        where[:, i], by_body[:, i] = R @ offsets[i], R @ BASIS[:, i].T
        if parent >= 0:
            where[:, i] += where[:, parent]
            by_body[:, i] += by_body[:, parent]
        if i < len(JOINTS):
            for d in np.flatnonzero(np.array(DOF_JOINT) == i):
                axes[:, d] = R @ AXES[d]
                R = R @ axis_angle(AXES[d], angles[:, d])
            rotations.append(R)
    arms = where[:, labels, None] - where[:, None, list(DOF_JOINT)]  # (T, 18, 37, 3)
    by_angle = np.cross(axes[:, None], arms) * MOVES[labels, :, None]
    return where[:, labels], np.swapaxes(by_angle, -1, -2), by_body[:, labels]
