"""Uncertainty of a track: covariances of angles and joints, and the joints' confidences.

The inverse of the energy's Gauss-Newton matrix at its minimum is the covariance of the angles:
given all frames where they were solved together, given the past where they were solved one by one.
The skeleton's model error is added to the joints' covariances.

Source: Laplace's approximation; blocks of the inverse: Takahashi et al. 1973, as the recursion of
Rauch, Tung & Striebel 1965 runs it for a chain.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.skeleton import DOF_COUNT, SPREAD, HasOffsets, jacobian
from egocap.pose.config import TrackerConfig
from egocap.pose.kernel import Model, information
from egocap.pose.motion_prior import NO_MOTION_PREDICTION, MotionPrediction
from egocap.pose.observations import Observations
from egocap.track.smoother import interval_system, windows

CORRECT_M = 0.05
"""Distance from the truth, metres, below which a joint counts as correct."""


def interval_covariances(
    angles: Float[Array, "T 37"], observations: Observations, model: Model, config: TrackerConfig,
    prediction: MotionPrediction = NO_MOTION_PREDICTION,
) -> Float[Array, "T 37 37"]:  # fmt: skip
    """Covariance [rad^2] of every frame's angles given all frames."""
    covariances = np.empty((len(angles), DOF_COUNT, DOF_COUNT))
    for kept, window, within in windows(len(angles)):
        _, bands, _ = interval_system(
            angles[window], observations[window], model, config, prediction[window]
        )
        covariances[kept] = banded_inverse(bands)[within]
    return covariances


def banded_inverse(
    bands: Float[Array, "K N"], size: int = DOF_COUNT
) -> Float[Array, "T {size} {size}"]:
    """Diagonal blocks of the inverse of a matrix that couples each frame to the next two.

    A frame has `size` unknowns. Two frames make a block of a block-tridiagonal matrix; an odd last
    one is padded.
    """
    frames = bands.shape[1] // size
    blocks = -(-frames // 2)
    diagonal, below = _blocks(bands, blocks, size)
    gains, reduced = np.empty_like(diagonal), np.empty_like(diagonal)
    information = diagonal[0]
    for k in range(blocks):
        reduced[k] = np.linalg.inv(information)
        if k + 1 < blocks:
            gains[k] = below[k] @ reduced[k]
            information = diagonal[k + 1] - gains[k] @ below[k].T
    inverse = reduced
    for k in range(blocks - 2, -1, -1):
        inverse[k] += gains[k].T @ inverse[k + 1] @ gains[k]
    n = size
    pairs = np.stack([inverse[:, :n, :n], inverse[:, n:, n:]], 1).reshape(-1, n, n)
    return pairs[:frames]


def _blocks(
    bands: Float[Array, "K N"], blocks: int, unknowns: int
) -> tuple[Float[Array, "B M M"], Float[Array, "B-1 M M"]]:
    """The blocks on and below the diagonal of a symmetric band."""
    n, size = 2 * unknowns, bands.shape[1]
    padded = np.zeros((n + 1, blocks * n))
    padded[:, :size] = bands
    padded[0, size:] = 1.0
    at = np.arange(n)
    row, column = np.meshgrid(at, at, indexing="ij")
    inside = row >= column
    diagonal = np.zeros((blocks, n, n))
    below = np.zeros((max(blocks - 1, 0), n, n))
    starts = n * np.arange(blocks)[:, None]
    diagonal[:, row[inside], column[inside]] = padded[(row - column)[inside],
                                                      starts + column[inside]]  # fmt: skip
    diagonal += np.swapaxes(np.tril(diagonal, -1), 1, 2)
    near = row + n - column <= n
    below[:, row[near], column[near]] = padded[(row + n - column)[near],
                                               starts[:-1] + column[near]]  # fmt: skip
    return diagonal, below


def causal_covariances(
    angles: Float[Array, "T 37"], observations: Observations, model: Model, config: TrackerConfig
) -> Float[Array, "T 37 37"]:
    """Covariance [rad^2] of every frame's angles given the frames up to it."""
    covariances = np.empty((len(angles), DOF_COUNT, DOF_COUNT))
    steps, last = np.diff(observations.times, prepend=observations.times[:1]), None
    for t, pose in enumerate(np.ascontiguousarray(angles)):
        matrix, _ = information(model, pose, observations.frame(t), config.robust_scale)
        last = update_covariance(last, matrix, config.velocity_sigma * steps[t])
        covariances[t] = last
    return covariances


def update_covariance(
    last: Float[Array, "37 37"] | None, matrix: Float[Array, "37 37"], drift: float
) -> Float[Array, "37 37"]:
    """Covariance of the angles from that at the last frame, if any, and a frame's information.

    `drift` is the standard deviation of the motion in between, in each angle's prior deviation.
    """
    if last is None:
        return np.linalg.inv(matrix)
    predicted = last + np.diag(np.square(drift * SPREAD))
    return np.linalg.inv(matrix + np.linalg.inv(predicted))


def joint_covariances(
    proportions: HasOffsets, angles: Float[Array, "T 37"],
    covariances: Float[Array, "T 37 37"], model_error_m: float,
) -> Float[Array, "T 18 3 3"]:  # fmt: skip
    """Covariance [m^2] of the joints' positions in the head frame."""
    _, J = jacobian(proportions, angles)
    spread = np.matmul(J.reshape(len(angles), -1, DOF_COUNT), covariances)
    spread = spread.reshape(J.shape) @ np.swapaxes(J, -1, -2)
    return spread + model_error_m**2 * np.eye(3)


def joint_deviations(
    proportions: HasOffsets, angles: Float[Array, "T 37"],
    covariances: Float[Array, "T 37 37"], model_error_m: float,
) -> Float[Array, "T 18"]:  # fmt: skip
    """Standard deviations [m] of the joints' positions along an axis, as if isotropic."""
    found = joint_covariances(proportions, angles, covariances, model_error_m)
    return np.sqrt(np.maximum(np.trace(found, axis1=-2, axis2=-1) / 3.0, 0.0))


def confidences(covariances: Float[Array, "T 18 3 3"]) -> Float[Array, "T 18"]:
    """Probability that each joint lies within `CORRECT_M` of its estimate: 0 to 1.

    The error is taken as isotropic, so that its length has Maxwell's distribution.
    """
    from scipy.special import erf

    deviation = np.sqrt(np.maximum(np.trace(covariances, axis1=-2, axis2=-1) / 3.0, 1e-12))
    x = CORRECT_M / deviation
    chance = erf(x / np.sqrt(2.0)) - np.sqrt(2.0 / np.pi) * x * np.exp(-0.5 * x**2)
    return np.clip(chance, 0.0, 1.0)
