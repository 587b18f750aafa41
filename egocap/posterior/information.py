"""Fisher information of the angles and Cramer-Rao bounds of the joints.

A detection with covariance C of a joint at X informs about the angles by (dpixel/dangles)^T C^-1
(dpixel/dangles); Student-t errors by a constant times that. The bound on a joint's covariance is
the inverse information propagated to the joint. Without a prior, what no camera sees cannot be
estimated and has no bound. With the posture's Gaussian, and with the tracker's random accelerations
between frames, the bound is the Bayesian one at the given motion.

Source: Van Trees, Detection, Estimation, and Modulation Theory, part I, sections 2.4.2 and 2.4.3;
Tichavsky, Muravchik & Nehorai 1998 (posterior bound over time); Lange, Little & Taylor 1989
(information of the t distribution); Rybicki & Hummer 1991 (diagonal of a tridiagonal's inverse).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.skeleton import AGILITY, DOF_COUNT, LIMITS, HasOffsets, jacobian
from egocap.cameras.rig import Rig
from egocap.errors import InputError
from egocap.pose.config import TrackerConfig
from egocap.pose.energy import acceleration_stencil
from egocap.pose.observations import REFERENCE_WIDTH
from egocap.pose.pose_prior import load_posture

UNSEEN = 1e-9
"""Fraction of the largest information below which a direction counts as unobserved."""


@dataclass(frozen=True)
class Noise:
    """Noise of detections. Raises InputError for impossible values."""

    sigma: float = 2.0  # standard deviation along each axis, pixels at an image width of 640
    degrees: float = np.inf  # of freedom of Student-t errors, above 2; inf: Gaussian
    model_error_m: float = 0.0  # scatter of true joints about the skeleton, metres
    correlation: float = 0.0  # of a detection's errors in successive frames, 0 to below 1

    def __post_init__(self) -> None:
        if not 1e-3 <= self.sigma <= 1e6:
            raise InputError(f"detections with sigma {self.sigma}", valid="0.001 to 1e6 px")
        if not self.degrees > 2.0:
            raise InputError(f"degrees = {self.degrees}", valid="above 2, inf for Gaussian errors")
        if not (0.0 <= self.model_error_m < np.inf):
            raise InputError(f"model_error_m = {self.model_error_m}", valid="from 0")
        if not (0.0 <= self.correlation < 1.0):
            raise InputError(f"correlation = {self.correlation}", valid="0 to below 1")

    @property
    def gain(self) -> float:
        """Information relative to Gaussian errors of the same standard deviation."""
        if np.isinf(self.degrees):
            return 1.0
        nu = self.degrees
        return (nu + 2.0) / (nu + 4.0) * nu / (nu - 2.0)


def place_information(
    joints_head: Float[Array, "B 18 3"],
    rig: Rig,
    seen: Bool[Array, "B V 18"],
    noise: Noise,
    spreads: Float[Array, "B V 18"] | None = None,
) -> Float[Array, "B 18 3 3"]:
    """Fisher information [m^-2] about each joint's place from its own detections alone.

    `spreads` are the detections' own standard deviations, in pixels of the rig's images, and stand
    in for the noise's.
    """
    W = _whitened(joints_head, rig, seen, noise, spreads)
    return np.sum(np.swapaxes(W, -1, -2) @ W, axis=1)


def _whitened(
    joints_head: Float[Array, "B 18 3"],
    rig: Rig,
    seen: Bool[Array, "B V 18"],
    noise: Noise,
    spreads: Float[Array, "B V 18"] | None,
) -> Float[Array, "B V 18 2 3"]:
    """Standard deviations that each detection moves by a metre of its joint; 0 where unseen."""
    _, J, _ = rig.project_jacobian(joints_head)  # (V, B, 18, 2, 3)
    W = np.zeros((*seen.shape, 2, 3))
    for v, camera in enumerate(rig.cameras):
        stated = noise.sigma * camera.width / REFERENCE_WIDTH
        # Values of missing detections are arbitrary; they are left out below.
        sigma = np.where(seen[:, v], stated if spreads is None else spreads[:, v], stated)
        JJ = J[v] @ np.swapaxes(J[v], -1, -2)
        covariance = sigma[..., None, None] ** 2 * np.eye(2) + noise.model_error_m**2 * JJ
        white = np.linalg.solve(np.linalg.cholesky(covariance), J[v])
        W[:, v] = white * (np.sqrt(noise.gain) * seen[:, v, :, None, None])
    return W


def fisher_information(
    angles: Float[Array, "B 37"],
    proportions: HasOffsets,
    rig: Rig,
    seen: Bool[Array, "B V 18"],
    noise: Noise,
    spreads: Float[Array, "B V 18"] | None = None,
) -> Float[Array, "B 37 37"]:
    """Fisher information [rad^-2] about the angles from all detections that are made."""
    joints, J = jacobian(proportions, angles)
    place = place_information(joints, rig, seen, noise, spreads)
    return _carried(place, J, J)


def image_sensitivity(
    angles: Float[Array, "B 37"],
    proportions: HasOffsets,
    rig: Rig,
    seen: Bool[Array, "B V 18"],
    noise: Noise,
    spreads: Float[Array, "B V 18"] | None = None,
) -> Float[Array, "B V 18 2 37"]:
    """Standard deviations that each detection moves by a radian of each angle; 0 where unseen."""
    joints, J = jacobian(proportions, angles)
    return _whitened(joints, rig, seen, noise, spreads) @ J[:, None]


def lasting_information(
    angles: Float[Array, "T 37"],
    proportions: HasOffsets,
    rig: Rig,
    seen: Bool[Array, "T V 18"],
    noise: Noise,
    spreads: Float[Array, "T V 18"] | None = None,
) -> tuple[Float[Array, "T 37 37"], Float[Array, "L 37 37"]]:
    """Fisher information [rad^-2] of a motion's detections whose errors last from frame to frame.

    Of every frame's angles, and between those of each frame and the next (L = T - 1). In
    standard deviations, a detection's error is `noise.correlation` times its last one and something
    new; where it was not made in the frame before, all of it is new.
    """
    joints, J = jacobian(proportions, angles)
    W = _whitened(joints, rig, seen, noise, spreads)
    rho = noise.correlation
    new = 1.0 / (1.0 - rho**2)
    lasts = seen[:-1] & seen[1:]
    share = np.ones(seen.shape)
    share[1:][lasts] += new - 1.0  # the new part has a smaller variance
    share[:-1][lasts] += rho**2 * new  # and informs about the frame before
    own = np.sum(share[..., None, None] * (np.swapaxes(W, -1, -2) @ W), axis=1)
    cross = np.swapaxes(W[:-1], -1, -2) @ W[1:]
    between = -rho * new * np.sum(lasts[..., None, None] * cross, axis=1)
    return _carried(own, J, J), _carried(between, J[:-1], J[1:])


def _carried(
    place: Float[Array, "B 18 3 3"], J: Float[Array, "B 18 3 37"], other: Float[Array, "B 18 3 37"]
) -> Float[Array, "B 37 37"]:
    """Information about joints' places, propagated to two sets of angles."""
    rows = J.shape[1] * J.shape[2]
    flat = np.swapaxes(J.reshape(-1, rows, DOF_COUNT), 1, 2)  # (B, 37, 54)
    return flat @ (place @ other).reshape(-1, rows, DOF_COUNT)


def prior_information(
    angles: Float[Array, "B 37"], weight: float = 1.0, limit_weight: float = 0.0
) -> Float[Array, "B 37 37"]:
    """Information of the prior: the posture's precision times a weight, and exceeded limits."""
    beyond = (angles > LIMITS[:, 1]) | (angles < LIMITS[:, 0])
    walls = 2.0 * limit_weight * beyond[..., None] * np.eye(DOF_COUNT)
    return weight * load_posture().precision + walls


def joint_covariance(
    angles: Float[Array, "B 37"], proportions: HasOffsets, covariance: Float[Array, "B 37 37"]
) -> Float[Array, "B 18 3 3"]:
    """Covariance [m^2] of the joints' places from that of the angles, to first order."""
    _, J = jacobian(proportions, angles)
    return J @ covariance[:, None] @ np.swapaxes(J, -1, -2)


def joint_bound(
    angles: Float[Array, "B 37"], proportions: HasOffsets, information: Float[Array, "B 37 37"]
) -> tuple[Float[Array, "B 18 3 3"], Bool[Array, "B 18"]]:
    """Cramer-Rao bound [m^2] on each joint's covariance, and whether the joint has one.

    A joint that moves along an unobserved direction of the angles has none; its covariance is
    meaningless.
    """
    _, J = jacobian(proportions, angles)
    values, vectors = np.linalg.eigh(information)
    known = values > UNSEEN * values[:, -1:]
    inverse = np.where(known, 1.0 / np.where(known, values, 1.0), 0.0)
    along = J @ vectors[:, None]  # (B, 18, 3, 37)
    covariance = (along * inverse[:, None, None]) @ np.swapaxes(along, -1, -2)
    lost = np.max(np.abs(along) * ~known[:, None, None], axis=(-2, -1))
    return covariance, lost < 1e-4  # metres per radian: a tenth of a millimetre


def rms_mm(covariance: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch"]:
    """Root mean square distance [mm] that goes with covariances [m^2]."""
    return 1e3 * np.sqrt(np.trace(covariance, axis1=-2, axis2=-1))


def smoothed_covariance(
    information: Float[Array, "T 37 37"], times: Float[Array, "T"], acceleration: float = 1.0,
    between: Float[Array, "L 37 37"] | None = None,
) -> Float[Array, "T 37 37"]:  # fmt: skip
    """Bayesian bound [rad^2] of every frame's angles given all frames.

    `information` is each frame's own: detections and what is known beforehand; `between`, that
    between each frame and the next (`lasting_information`). Frames are tied by white accelerations
    of density `acceleration` times `skeleton.AGILITY`, the tracker's. Raises
    InputError when a time does not follow the one before, or nothing fixes the motion.
    """
    if len(times) != len(information) or not (np.diff(times) > 0).all():
        raise InputError("the times do not increase from frame to frame")
    stencil = acceleration_stencil(times)
    diagonal, upper = _pairs(information, stencil, acceleration * AGILITY, between)
    try:
        blocks = _inverse_diagonal(diagonal, upper)
    except np.linalg.LinAlgError:
        raise InputError("nothing fixes the motion: some angles are unknown in every frame",
                         valid="a prior, or more detections") from None  # fmt: skip
    n = DOF_COUNT
    both = np.stack([blocks[:, :n, :n], blocks[:, n:, n:]], 1).reshape(-1, n, n)
    return both[: len(information)]


def smoothed_bound(
    angles: Float[Array, "T 37"],
    proportions: HasOffsets,
    times: Float[Array, "T"],
    information: Float[Array, "T 37 37"],
    config: TrackerConfig,
    between: Float[Array, "L 37 37"] | None = None,
) -> Float[Array, "T 18"]:
    """Bound [mm] on every joint's error given a whole motion's detections and a tracker's priors.

    `information` is that of each frame's detections, `between` that between successive frames
    (`lasting_information`).
    """
    known = information + prior_information(angles, config.lambda_posture)
    covariance = smoothed_covariance(known, times, config.acceleration_sigma, between)
    return rms_mm(joint_covariance(angles, proportions, covariance))


def _pairs(
    information: Float[Array, "T 37 37"], stencil: Float[Array, "T 3"],
    density: Float[Array, "37"], between: Float[Array, "L 37 37"] | None = None,
) -> tuple[Float[Array, "P 74 74"], Float[Array, "P 74 74"]]:  # fmt: skip
    """Two frames to a block, so that accelerations over three frames reach the next block only.

    An odd number of frames is padded with one that is independent of the others.
    """
    frames, n = len(information), DOF_COUNT
    count = (frames + 1) // 2
    diagonal, upper = np.zeros((count, 2 * n, 2 * n)), np.zeros((count, 2 * n, 2 * n))
    dofs = np.arange(n)

    def add(i: int, j: int, values: Float[Array, "37"]) -> None:
        block = diagonal if i // 2 == j // 2 else upper
        block[i // 2, i % 2 * n + dofs, j % 2 * n + dofs] += values

    for t in range(frames):
        where = slice(t % 2 * n, (t % 2 + 1) * n)
        diagonal[t // 2, where, where] += information[t]
    for t in range(frames - 2):
        for a in range(3):
            for b in range(3):
                if (t + a) // 2 <= (t + b) // 2:
                    add(t + a, t + b, stencil[t, a] * stencil[t, b] / density**2)
    if between is not None:
        diagonal[: frames // 2, :n, n:] += between[::2]
        diagonal[: frames // 2, n:, :n] += np.swapaxes(between[::2], 1, 2)
        upper[: (frames - 1) // 2, n:, :n] += between[1::2]
    if frames % 2:
        diagonal[-1, n + dofs, n + dofs] = 1.0
    return diagonal, upper


def _inverse_diagonal(
    diagonal: Float[Array, "P M M"], upper: Float[Array, "P M M"]
) -> Float[Array, "P M M"]:
    """Diagonal blocks of the inverse of a symmetric block tridiagonal matrix.

    `upper[i]` is right of `diagonal[i]`. The blocks before and behind each block are eliminated.
    """
    count = len(diagonal)
    before, behind = diagonal.copy(), diagonal.copy()
    for i in range(1, count):
        before[i] -= upper[i - 1].T @ np.linalg.solve(before[i - 1], upper[i - 1])
    for i in range(count - 2, -1, -1):
        behind[i] -= upper[i] @ np.linalg.solve(behind[i + 1], upper[i].T)
    return np.linalg.inv(before + behind - diagonal)
