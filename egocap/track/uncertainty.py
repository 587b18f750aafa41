"""How sure a track is: covariance of every joint, and the chance that it is right.

Near its minimum the energy is a negative log-posterior, and the inverse of its Gauss-Newton matrix
the covariance of the angles: with past and future where all frames were solved together, with the
past alone where they were solved one by one. What the tracker's skeleton cannot follow is added.

Source: Laplace's approximation; blocks of the inverse: Takahashi et al. 1973, as the recursion of
Rauch, Tung & Striebel 1965 runs it for a chain.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.skeleton import DOF_COUNT, SPREAD, HasOffsets, jacobian
from egocap.pose.config import TrackerConfig
from egocap.pose.kernel import Model, detections, priors
from egocap.pose.motion_prior import NO_GUIDE, Guide
from egocap.pose.observations import Observations
from egocap.track.smoother import BAND, MARGIN, WINDOW, interval_system

RIGHT_M = 0.05
"""A joint is right when it lies within so many metres of the truth: a few centimetres are flesh."""


def interval_covariances(
    angles: Float[Array, "T 37"], observations: Observations, model: Model, config: TrackerConfig,
    guide: Guide = NO_GUIDE,
) -> Float[Array, "T 37 37"]:  # fmt: skip
    """Covariance [rad^2] of every frame's angles given all frames, and a guide if there is one."""
    covariances = np.empty((len(angles), DOF_COUNT, DOF_COUNT))
    for first in range(0, len(angles), WINDOW):
        last = min(first + WINDOW, len(angles))
        low, high = max(first - MARGIN, 0), min(last + MARGIN, len(angles))
        window = slice(low, high)
        _, bands, _ = interval_system(
            angles[window], observations[window], model, config, guide[window]
        )
        covariances[first:last] = banded_inverse(bands)[first - low : last - low]
    return covariances


def banded_inverse(bands: Float[Array, "75 N"]) -> Float[Array, "T 37 37"]:
    """Diagonal blocks of the inverse of a matrix whose frames meet the next two only.

    Two frames make a block of a block-tridiagonal matrix; an odd last one gets a dummy beside it.
    """
    frames = bands.shape[1] // DOF_COUNT
    blocks = -(-frames // 2)
    diagonal, below = _blocks(bands, blocks)
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
    n = DOF_COUNT
    pairs = np.stack([inverse[:, :n, :n], inverse[:, n:, n:]], 1).reshape(-1, n, n)
    return pairs[:frames]


def _blocks(
    bands: Float[Array, "75 N"], blocks: int
) -> tuple[Float[Array, "B 74 74"], Float[Array, "B-1 74 74"]]:
    """The blocks on and below the diagonal of a symmetric band."""
    n, size = 2 * DOF_COUNT, bands.shape[1]
    padded = np.zeros((BAND + 1, blocks * n))
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
    near = row + n - column <= BAND
    below[:, row[near], column[near]] = padded[(row + n - column)[near],
                                               starts[:-1] + column[near]]  # fmt: skip
    return diagonal, below


def causal_covariances(
    angles: Float[Array, "T 37"], observations: Observations, model: Model, config: TrackerConfig
) -> Float[Array, "T 37 37"]:
    """Covariance [rad^2] of every frame's angles given the frames up to it."""
    covariances = np.empty((len(angles), DOF_COUNT, DOF_COUNT))
    for t, pose in enumerate(np.ascontiguousarray(angles)):
        H, g = np.zeros((DOF_COUNT, DOF_COUNT)), np.zeros(DOF_COUNT)
        detections(
            model, pose, observations.centres, observations.rays[t], observations.whiten[t],
            observations.weights[t], float(config.robust_scale), H, g,
        )  # fmt: skip
        priors(model, pose, H, g)
        information = H + np.tril(H, -1).T
        if t > 0:
            step = observations.times[t] - observations.times[t - 1]
            drift = np.diag(np.square(config.speed * step * SPREAD))
            information = information + np.linalg.inv(covariances[t - 1] + drift)
        covariances[t] = np.linalg.inv(information)
    return covariances


def joint_covariances(
    proportions: HasOffsets, angles: Float[Array, "T 37"],
    covariances: Float[Array, "T 37 37"], model_error_m: float,
) -> Float[Array, "T 18 3 3"]:  # fmt: skip
    """Covariance [m^2] of the joints' positions in the head frame."""
    _, J = jacobian(proportions, angles)
    spread = np.matmul(J.reshape(len(angles), -1, DOF_COUNT), covariances)
    spread = spread.reshape(J.shape) @ np.swapaxes(J, -1, -2)
    return spread + model_error_m**2 * np.eye(3)


def confidences(covariances: Float[Array, "T 18 3 3"]) -> Float[Array, "T 18"]:
    """Chance that each joint lies within `RIGHT_M` of its estimate: 0 to 1.

    The error is taken as equally wide in all directions, its length as Maxwell's distribution.
    """
    from scipy.special import erf

    deviation = np.sqrt(np.maximum(np.trace(covariances, axis1=-2, axis2=-1) / 3.0, 1e-12))
    x = RIGHT_M / deviation
    chance = erf(x / np.sqrt(2.0)) - np.sqrt(2.0 / np.pi) * x * np.exp(-0.5 * x**2)
    return np.clip(chance, 0.0, 1.0)
