"""Estimation of a constant time lag and a small rotation of every view against the first.

Gauss-Newton on the energy of a window of frames, with the poses eliminated by the Schur complement
of their banded normal equations.

Source: Triggs et al. 2000, "Bundle adjustment - a modern synthesis", section 6.1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.skeleton import DOF_COUNT, HasOffsets, jacobian
from egocap.geometry import axis_angle, unit
from egocap.pose.config import TrackerConfig
from egocap.pose.energy import angular_residual
from egocap.pose.kernel import Model
from egocap.pose.observations import Observations
from egocap.track.smoother import interval_system

WINDOW = 400
"""Frames used; the middle ones of a longer motion."""
LAG_SIGMA_S, ROTATION_SIGMA = 0.02, np.deg2rad(1.0)
"""Prior standard deviations of lags and rotations."""
_PARAMETERS = 4  # of a view: lag and rotation


@dataclass(frozen=True, eq=False)
class Alignment:
    """Lags and rotations of the views relative to the rig file."""

    lag_s: Float[Array, "V"]  # of a view's images behind the first view's
    rotation: Float[Array, "V 3"]  # rad, axis times angle in the head frame: corrects its rays

    @classmethod
    def none(cls, views: int) -> Alignment:
        """No lag and no rotation."""
        return cls(np.zeros(views), np.zeros((views, 3)))

    def aligned(self, observations: Observations, joints: Float[Array, "T 18 3"]) -> Observations:
        """The observations corrected for lag and rotation, about a track's joints."""
        rays, whiten = observations.rays.copy(), observations.whiten.copy()
        _, drift = _directions(observations, joints)
        for v, (lag, turn) in enumerate(zip(self.lag_s, self.rotation, strict=True)):
            # Rays and whiteners turn together, first by the rotation, then by the lag.
            R = axis_angle(unit(turn), float(np.linalg.norm(turn)))
            rays[:, v] = rays[:, v] @ R.T
            back = -lag * np.cross(rays[:, v], drift[:, v])
            back_R = axis_angle(unit(back), np.linalg.norm(back, axis=-1))
            rays[:, v] = np.einsum("tjab,tjb->tja", back_R, rays[:, v])
            whiten[:, v] = np.einsum("tjab,tjcb->tjca", back_R, whiten[:, v] @ R.T)
        return replace(observations, rays=rays, whiten=whiten)


def improve(
    alignment: Alignment, angles: Float[Array, "T 37"], observations: Observations,
    proportions: HasOffsets, model: Model, config: TrackerConfig,
) -> Alignment:  # fmt: skip
    """One Gauss-Newton step. `observations` are as detected, `angles` the best fit once aligned.

    Lags stay at 0 without `config.synchronise`, rotations without `config.align_cameras`.
    """
    first = max((len(angles) - WINDOW) // 2, 0)
    window = slice(first, first + WINDOW)
    angles, observations = np.ascontiguousarray(angles[window]), observations[window]
    joints, J = jacobian(proportions, angles)
    seen = alignment.aligned(observations, joints)
    gradient, curvature, cross = _normal_equations(seen, joints, J, config)
    S = curvature - cross.T @ _solve_poses(angles, seen, model, config, cross)
    views = len(observations.centres)
    current = np.concatenate([alignment.lag_s[1:, None], alignment.rotation[1:]], 1).ravel()
    expected = np.tile([LAG_SIGMA_S, *3 * [ROTATION_SIGMA]], views - 1) ** -2.0
    free = np.tile([config.synchronise] + 3 * [config.align_cameras], views - 1)
    S, right = S + np.diag(expected), gradient + expected * current
    step = np.zeros(len(current))
    step[free] = -np.linalg.solve(S[np.ix_(free, free)], right[free])
    found = (current + step).reshape(-1, _PARAMETERS)
    zero = np.zeros((1, _PARAMETERS))
    found = np.concatenate([zero, found])
    return Alignment(found[:, 0], found[:, 1:])


def _directions(
    observations: Observations, joints: Float[Array, "T 18 3"]
) -> tuple[Float[Array, "T V 18 3"], Float[Array, "T V 18 3"]]:
    """Directions to a track's joints and how fast they turn [1/s]."""
    arms = joints[:, None] - observations.centres[:, None]
    distance = np.maximum(np.linalg.norm(arms, axis=-1, keepdims=True), 1e-3)
    direction = arms / distance
    speed = np.zeros_like(joints)
    if len(joints) > 1:
        speed = np.gradient(joints, observations.times, axis=0)
    drift = speed[:, None] - direction * np.sum(direction * speed[:, None], -1, keepdims=True)
    return direction, drift / distance


def _normal_equations(
    seen: Observations, joints: Float[Array, "T 18 3"], J: Float[Array, "T 18 3 37"],
    config: TrackerConfig,
) -> tuple[Float[Array, "P"], Float[Array, "P P"], Float[Array, "N P"]]:  # fmt: skip
    """Gradient and matrix of the views' parameters, and the block coupling them to the poses."""
    direction, drift = _directions(seen, joints)
    residual = angular_residual(joints[:, None], seen.centres[:, None], seen.rays, seen.whiten)
    scale2 = config.robust_scale**2
    share = scale2 / (np.sum(residual**2, -1) + scale2)
    weight = seen.weights * share**2  # (T, V, 18)
    arms = joints[:, None] - seen.centres[:, None]
    distance = np.maximum(np.linalg.norm(arms, axis=-1), 1e-3)
    views = len(seen.centres)
    # A later image shows the joint further on; turning the ray one way turns the joint back.
    by_lag = np.einsum("tvjab,tvjb->tvja", seen.whiten, drift)[..., None]
    crossed = np.cross(direction[..., None, :], np.eye(3))  # d x e_k = -(e_k x d)
    by_turn = np.einsum("tvjab,tvjkb->tvjak", seen.whiten, crossed)
    slopes = np.concatenate([by_lag, by_turn], -1)  # (T, V, 18, 2, 4)
    across = seen.whiten / distance[..., None, None]
    frames = len(joints)
    gradient = np.zeros((views, _PARAMETERS))
    curvature = np.zeros(((views - 1) * _PARAMETERS,) * 2)
    cross = np.zeros((frames, DOF_COUNT, (views - 1) * _PARAMETERS))
    for v in range(1, views):
        own = slice((v - 1) * _PARAMETERS, v * _PARAMETERS)
        weighed = weight[:, v, :, None, None] * slopes[:, v]
        gradient[v] = np.einsum("tjap,tja->p", weighed, residual[:, v])
        curvature[own, own] = np.einsum("tjap,tjaq->pq", weighed, slopes[:, v])
        by_pose = across[:, v] @ J  # (T, 18, 2, 37)
        cross[:, :, own] = np.einsum("tjad,tjap->tdp", by_pose, weighed)
    return gradient[1:].ravel(), curvature, cross.reshape(frames * DOF_COUNT, -1)


def _solve_poses(
    angles: Float[Array, "T 37"], seen: Observations, model: Model, config: TrackerConfig,
    right: Float[Array, "N P"],
) -> Float[Array, "N P"]:  # fmt: skip
    """The inverse of the poses' normal equations, times some columns."""
    from scipy.linalg import solveh_banded

    _, bands, _ = interval_system(angles, seen, model, config)
    return solveh_banded(bands, right, lower=True)
