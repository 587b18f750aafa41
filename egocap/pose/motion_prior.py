"""The learned motion prior: joint angles as a stationary Gaussian process.

The covariances of all angles, up to two seconds apart, are learned from motions
(`egocap-eval learn-prior motion`). Detections of a track, linearised, go in; a Gaussian
over every frame's angles comes out, occluded ones included, which the smoother adds as a term.
Knots lie a tenth of a second apart; overlapping windows of them are solved at once.

Source: Rasmussen & Williams 2006, "Gaussian Processes for Machine Learning", sections 2.2 and 9.1;
Wang, Fleet & Hertzmann 2008, "Gaussian process dynamical models for human motion", for the idea.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.skeleton import DOF_COUNT, DOFS, MIRROR_DOFS, MIRROR_SIGNS
from egocap.errors import FileError
from egocap.files import read_npz, usable, write_npz
from egocap.pose.config import TrackerConfig
from egocap.pose.kernel import Model, information
from egocap.pose.observations import Observations
from egocap.series import interpolate

FILE = Path(__file__).with_name("motion_prior.npz")
STEP_S = 0.1
LAGS = 21
"""Knots in a window: two seconds."""
_HOP = 10  # knots that a window contributes
_SLACK = np.deg2rad(2.0)
"""Standard deviation of every angle about the process, which keeps its covariance regular."""
_MAX_KNOTS = 150  # of one motion: longer ones weigh no more


@dataclass(frozen=True, eq=False)
class MotionPrior:
    """Mean [rad] of the angles and their covariances [rad^2] at lags of `STEP_S`."""

    mean: Float[Array, "37"]
    covariances: Float[Array, "21 37 37"]  # of angles with those so many knots before

    @cached_property
    def window(self) -> Float[Array, "777 777"]:
        """Covariance of all angles at all knots of a window."""
        blocks = [
            [self.covariances[i - j] if i >= j else self.covariances[j - i].T for j in range(LAGS)]
            for i in range(LAGS)
        ]
        return np.block(blocks)


@dataclass(frozen=True, eq=False)
class MotionPrediction:
    """A Gaussian over the angles of every frame."""

    mean: Float[Array, "T 37"]  # rad
    precision: Float[Array, "T 37 37"]  # rad^-2

    def __getitem__(self, frames: slice) -> MotionPrediction:
        """Some of the frames."""
        return MotionPrediction(self.mean[frames], self.precision[frames])

    def replaced(self, other: MotionPrediction, frames: Bool[Array, "T"]) -> MotionPrediction:
        """This, with some frames of another."""
        return MotionPrediction(
            np.where(frames[:, None], other.mean, self.mean),
            np.where(frames[:, None, None], other.precision, self.precision),
        )


NO_MOTION_PREDICTION = MotionPrediction(
    np.zeros((0, DOF_COUNT)), np.zeros((0, DOF_COUNT, DOF_COUNT))
)


def learn_motion_prior(motions: Sequence[Float[Array, "T 37"]], fps: float) -> MotionPrior:
    """Mean and covariances of some motions and their mirrors.

    Sums over pairs are divided by the number of all frames, not of pairs, which keeps the process
    positive definite.
    """
    stride = round(STEP_S * fps)
    parts = [
        part[start::stride]
        for motion in motions
        for part in (motion, motion[:, MIRROR_DOFS] * MIRROR_SIGNS)
        for start in range(stride)
    ]
    shares = [min(1.0, _MAX_KNOTS / max(len(part), 1)) for part in parts]
    total = sum(share * len(part) for share, part in zip(shares, parts, strict=True))
    mean = sum(share * part.sum(0) for share, part in zip(shares, parts, strict=True)) / total
    covariances = np.zeros((LAGS, DOF_COUNT, DOF_COUNT))
    for share, part in zip(shares, parts, strict=True):
        away = part - mean
        for lag in range(min(LAGS, len(part))):
            covariances[lag] += share * away[lag:].T @ away[: len(away) - lag] / total
    covariances[0] += _SLACK**2 * np.eye(DOF_COUNT)
    return MotionPrior(np.asarray(mean), covariances)


def save_motion_prior(prior: MotionPrior, path: Path = FILE) -> None:
    """Write a learned prior as npz, in single precision."""
    write_npz(
        path, dofs=np.array(DOFS), mean=prior.mean.astype(np.float32),
        covariances=prior.covariances.astype(np.float32),
    )  # fmt: skip


@cache
def load_motion_prior(path: Path = FILE) -> MotionPrior:
    """Read a learned prior. Raises FileError."""
    try:
        found = read_npz(path)
        prior = MotionPrior(found["mean"].astype(float), found["covariances"].astype(float))
    except (FileError, ValueError, KeyError):
        raise FileError(path, "not a motion prior") from None
    shapes = prior.mean.shape, prior.covariances.shape
    if not np.array_equal(found.get("dofs", ()), DOFS) or shapes != (
        (DOF_COUNT,), (LAGS, DOF_COUNT, DOF_COUNT)
    ):  # fmt: skip
        raise FileError(path, "not for this skeleton's angles", key="dofs")
    if not (usable(prior.mean).all() and usable(prior.covariances).all()):
        raise FileError(path, "holds values that are not finite, or too large")
    if not _positive_definite(prior):
        raise FileError(path, "not positive definite", key="covariances")
    return prior


def _positive_definite(prior: MotionPrior) -> bool:
    """By Cholesky's factorisation of a window, at a tenth of the cost of its eigenvalues."""
    try:
        np.linalg.cholesky(prior.window)  # reads one triangle
    except np.linalg.LinAlgError:
        return False
    return np.array_equal(prior.covariances[0], prior.covariances[0].T)


def predict_motion(
    angles: Float[Array, "T 37"], observations: Observations, model: Model, config: TrackerConfig
) -> MotionPrediction:
    """The motion prior's posterior of every frame's angles, given a track's detections.

    Detections are linearised about the track. A fraction `motion_information` of their information
    is used, as their errors are correlated over frames.
    """
    prior = load_motion_prior()
    matrices, gradients = np.empty((len(angles), DOF_COUNT, DOF_COUNT)), np.empty_like(angles)
    for t, pose in enumerate(np.ascontiguousarray(angles)):
        matrices[t], gradients[t] = information(
            model, pose, observations.frame(t), config.robust_scale, with_priors=False
        )
    matrices, targets = config.motion_information * matrices, -config.motion_information * gradients
    mean, precision = np.empty_like(angles), np.empty_like(matrices)
    for part in _stretches(observations.times):
        mean[part], precision[part] = _predict_stretch(
            observations.times[part], angles[part], matrices[part], targets[part], prior
        )
    return MotionPrediction(mean, precision)


def _stretches(times: Float[Array, "T"]) -> Iterator[slice]:
    """Runs of frames without a gap longer than a window."""
    breaks = np.flatnonzero(np.diff(times) > LAGS * STEP_S) + 1
    edges = [0, *breaks.tolist(), len(times)]
    yield from (slice(a, b) for a, b in pairwise(edges))


def _predict_stretch(
    times: Float[Array, "T"], angles: Float[Array, "T 37"], matrices: Float[Array, "T 37 37"],
    targets: Float[Array, "T 37"], prior: MotionPrior,
) -> tuple[Float[Array, "T 37"], Float[Array, "T 37 37"]]:  # fmt: skip
    """Mean and precision of the frames of a stretch."""
    from scipy.interpolate import make_interp_spline

    count = max(1, round((times[-1] - times[0]) / STEP_S) + 1)
    knots = times[0] + STEP_S * np.arange(count)
    nearest = np.clip(np.round((times - times[0]) / STEP_S).astype(int), 0, count - 1)
    at_knots = interpolate(knots, times, angles)
    knot_matrices, knot_targets = np.zeros((count, DOF_COUNT, DOF_COUNT)), np.zeros_like(at_knots)
    # A frame's information is moved to its knot along the track.
    departure = at_knots - prior.mean
    np.add.at(knot_matrices, nearest, matrices)
    np.add.at(
        knot_targets, nearest, targets + np.einsum("tij,tj->ti", matrices, departure[nearest])
    )
    means, covariances = condition(knot_matrices, knot_targets, prior)
    means += prior.mean
    degree = min(3, count - 1)
    spline = make_interp_spline(knots, means, k=degree) if count > 1 else lambda _: means
    mean = np.asarray(spline(np.minimum(times, knots[-1])))
    precision = np.linalg.inv(covariances + _SLACK**2 * np.eye(DOF_COUNT))
    return np.broadcast_to(mean, angles.shape), precision[nearest]


def condition(
    information: Float[Array, "N 37 37"], targets: Float[Array, "N 37"], prior: MotionPrior
) -> tuple[Float[Array, "N 37"], Float[Array, "N 37 37"]]:
    """Departure from the mean and covariance at every knot, given Gaussian information there.

    `targets` are the information matrices times the departures that they point at. Every knot is
    conditioned on those of at least half a second on either side.
    """
    from scipy.linalg import cho_solve, cholesky, solve_triangular

    count, n = targets.shape
    means, covariances = np.empty((count, n)), np.empty((count, n, n))
    for first in range(0, count, _HOP):
        last = min(first + _HOP, count)
        low = max(0, min(first - (LAGS - _HOP) // 2, count - LAGS))
        high = min(low + LAGS, count)
        # The knots that are kept come last: their marginal is the last block.
        order = [*range(low, first), *range(last, high), *range(first, last)]
        L = _ordered_precision(prior, tuple(k - low for k in order)).copy()
        for i, k in enumerate(order):
            L[i * n : (i + 1) * n, i * n : (i + 1) * n] += information[k]
        L = cholesky(L, lower=True, overwrite_a=True, check_finite=False)
        solved = cho_solve((L, True), targets[order].ravel(), check_finite=False)
        kept = (last - first) * n
        means[first:last] = solved[-kept:].reshape(-1, n)
        rest = solve_triangular(L[-kept:, -kept:], np.eye(kept), lower=True, check_finite=False)
        for i, k in enumerate(range(first, last)):
            column = rest[i * n :, i * n : (i + 1) * n]
            covariances[k] = column.T @ column
    return means, covariances


@lru_cache(maxsize=16)
def _ordered_precision(prior: MotionPrior, knots: tuple[int, ...]) -> Float[Array, "N N"]:
    """Inverse of the covariance of a window's first knots, these in the order given."""
    n = DOF_COUNT
    precision = _precision(prior, len(knots) * n)
    rows = (n * np.array(knots)[:, None] + np.arange(n)).ravel()
    return precision[np.ix_(rows, rows)]


@lru_cache(maxsize=16)
def _precision(prior: MotionPrior, size: int) -> Float[Array, "N N"]:
    precision = np.linalg.inv(prior.window[:size, :size])
    return (precision + precision.T) / 2.0
