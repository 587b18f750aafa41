"""Robust bundle adjustment of lenses, camera poses on the rig, and board poses.

Levenberg-Marquardt on Huber's loss with analytic derivatives. The unknowns of each instant are
eliminated from the normal equations (the Schur complement), so that a step costs time linear in the
number of pictures.

Source: Triggs et al. 2000, Bundle adjustment; Huber 1981; Nocedal and Wright 2006, section 10.3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from threadpoolctl import threadpool_limits

from egocap.calibration.state import Corners, State, jacobian, residuals_of

HUBER = 3.0  # standard deviations; 1 % of good corners lie beyond
_STEPS = 60
_TRIES = 12  # of the damping, for one step
_SMALL = 1e-7  # relative decrease of the cost at which the adjustment ends


@dataclass(frozen=True, eq=False)
class Adjusted:
    """The result of an adjustment."""

    state: State
    residuals: Float[Array, "N 2"]  # observed - projected, pixels
    scale: float  # standard deviation of whitened residuals
    covariance: Float[Array, "C C"]  # of the common unknowns' steps
    converged: bool

    @property
    def rms(self) -> float:
        """Root mean square of the coordinates of residuals, pixels."""
        return float(np.sqrt(np.mean(self.residuals**2)))


class _Equations(NamedTuple):
    """The normal equations H step = g in blocks: common unknowns, and those of each instant."""

    Hcc: Float[Array, "C C"]
    Hce: Float[Array, "I C 6"]
    Hee: Float[Array, "I 6 6"]
    gc: Float[Array, "C"]
    ge: Float[Array, "I 6"]


def adjust(
    state: State,
    corners: Corners,
    points: Float[Array, "K 3"],
    *,
    only_boards: bool = False,
    huber: float = HUBER,
) -> Adjusted:
    """Minimise the robust reprojection error over all unknowns, or over the boards' alone.

    `huber`: standard deviations beyond which a corner counts less; infinite for least squares. Not
    converging is stated in the result.
    """
    with threadpool_limits(1):  # the matrices are small: threads only wait for each other
        return _adjust(state, corners, points, only_boards, huber)


def whitened(residuals: Float[Array, "N 2"], corners: Corners) -> Float[Array, "N 2"]:
    """Residuals scaled to unit covariance, but for a common factor."""
    return np.einsum("nij,nj->ni", corners.whitening, residuals)


def robust_scale(residuals: Float[Array, "N 2"]) -> float:
    """Standard deviation of a coordinate, from the median of its absolute values."""
    return float(max(1.4826 * np.median(np.abs(residuals)), 1e-6))


def _adjust(
    state: State, corners: Corners, points: Array, only_boards: bool, huber: float
) -> Adjusted:
    residuals = residuals_of(state, corners, points)
    damping, converged = 1e-3, False
    for _ in range(_STEPS):
        white = whitened(residuals, corners)
        scale = robust_scale(white)
        cost = _cost(white, scale, huber)
        equations = _normal_equations(state, corners, points, scale, huber)
        for _ in range(_TRIES):
            new = state.moved(*_solve(equations, damping, only_boards))
            trial = residuals_of(new, corners, points)
            new_cost = _cost(whitened(trial, corners), scale, huber)
            if new_cost < cost:
                break
            damping *= 8.0
        else:  # no step decreases the cost any more
            converged = np.isfinite(cost)
            break
        state, residuals, damping = new, trial, max(damping / 8.0, 1e-12)
        if cost - new_cost < _SMALL * cost:
            converged = True
            break
    return _result(state, corners, points, residuals, converged, huber)


def _cost(white: Float[Array, "N 2"], scale: float, huber: float) -> float:
    """Huber's loss of the lengths of residuals; infinite where a projection failed."""
    length = np.linalg.norm(white, axis=1) / scale
    linear = np.maximum(length - huber, 0.0)
    inner = length - linear
    total = float((inner * (0.5 * inner + linear)).sum())
    return total if np.isfinite(total) else np.inf


def _weights(white: Float[Array, "N 2"], scale: float, huber: float) -> Float[Array, "N"]:
    length = np.linalg.norm(white, axis=1) / scale
    return np.minimum(1.0, huber / np.maximum(length, 1e-12))


def further_unknowns(
    adjusted: Adjusted, corners: Corners, points: Float[Array, "K 3"], by: Float[Array, "N 2 X"]
) -> tuple[Float[Array, "X"], Float[Array, "X X"]]:
    """Values and covariance of unknowns left out of an adjustment, all others free.

    `by`: derivatives of the projected pixels by them, where they are zero. One step of the same
    least squares; the covariance is scaled by the residuals.
    """
    white = whitened(adjusted.residuals, corners)
    scale = robust_scale(white)
    e = _normal_equations(adjusted.state, corners, points, scale, HUBER, by)
    by_common = np.linalg.solve(_damped(e.Hee, 1e-12), e.Hce.swapaxes(1, 2))
    own = np.linalg.solve(_damped(e.Hee, 1e-12), e.ge[..., None])[..., 0]
    H = _damped(e.Hcc - np.einsum("ice,ied->cd", e.Hce, by_common), 1e-12)
    step = _scaled_solve(H, e.gc - np.einsum("ice,ie->c", e.Hce, own))
    s = 1.0 / np.sqrt(np.diag(H))
    covariance = adjusted.scale**2 * np.linalg.inv(H * s[:, None] * s) * s[:, None] * s
    count = by.shape[2]
    return step[-count:], covariance[-count:, -count:]


def _normal_equations(
    state: State, corners: Corners, points: Array, scale: float, huber: float,
    further: Float[Array, "N 2 X"] | None = None,
) -> _Equations:  # fmt: skip
    """The normal equations; `further` are derivatives by more common unknowns."""
    white = whitened(residuals_of(state, corners, points), corners)
    root = np.sqrt(_weights(white, scale, huber))
    factor = root[:, None, None] * corners.whitening
    common, each = jacobian(state, corners, points)
    if further is not None:
        common = np.concatenate([common, further], -1)
    common, each = factor @ common, factor @ each
    left = root[:, None] * white
    instants, count = len(state.T_rig_board), common.shape[2]
    Hee = np.zeros((instants, 6, 6))
    Hce, ge = np.zeros((instants, count, 6)), np.zeros((instants, 6))
    np.add.at(Hee, corners.instant, each.swapaxes(1, 2) @ each)
    np.add.at(Hce, corners.instant, common.swapaxes(1, 2) @ each)
    np.add.at(ge, corners.instant, np.einsum("nke,nk->ne", each, left))
    flat = common.reshape(-1, count)
    return _Equations(flat.T @ flat, Hce, Hee, flat.T @ left.ravel(), ge)


def _solve(e: _Equations, damping: float, only_boards: bool) -> tuple[Array, Array]:
    """The damped step of the common unknowns and of those of each instant."""
    inner = _damped(e.Hee, damping)
    if only_boards:
        return np.zeros(len(e.gc)), np.linalg.solve(inner, e.ge[..., None])[..., 0]
    by_common = np.linalg.solve(inner, e.Hce.swapaxes(1, 2))  # (I, 6, C)
    own = np.linalg.solve(inner, e.ge[..., None])[..., 0]
    H = _damped(e.Hcc, damping) - np.einsum("ice,ied->cd", e.Hce, by_common)
    common = _scaled_solve(H, e.gc - np.einsum("ice,ie->c", e.Hce, own))
    return common, own - by_common @ common


def _damped(H: Float[Array, "*n a a"], damping: float) -> Float[Array, "*n a a"]:
    """H with its diagonal increased; unknowns that nothing determines stay where they are."""
    diagonal = np.diagonal(H, axis1=-2, axis2=-1)
    more = np.where(diagonal > 0, damping * diagonal, 1.0)
    return H + more[..., None] * np.eye(H.shape[-1])


def _scaled_solve(H: Array, g: Array) -> Array:
    s = 1.0 / np.sqrt(np.maximum(np.diag(H), 1e-12))
    try:
        return s * np.linalg.solve(H * s[:, None] * s, s * g)
    except np.linalg.LinAlgError:
        return np.zeros(len(g))


def _result(
    state: State, corners: Corners, points: Array, residuals: Array, converged: bool, huber: float
) -> Adjusted:
    white = whitened(residuals, corners)
    scale = robust_scale(white)
    unknowns = state.common + 6 * len(np.unique(corners.instant))
    surplus = max(2 * len(corners) - unknowns, 1)
    weights = _weights(white, scale, huber)
    variance = float((weights[:, None] * white**2).sum() / surplus)
    if not np.isfinite(variance):
        nothing = np.full((state.common, state.common), np.inf)
        return Adjusted(state, residuals, np.inf, nothing, False)
    e = _normal_equations(state, corners, points, scale, huber)
    by_common = np.linalg.solve(_damped(e.Hee, 1e-12), e.Hce.swapaxes(1, 2))
    H = e.Hcc - np.einsum("ice,ied->cd", e.Hce, by_common)
    s = 1.0 / np.sqrt(np.maximum(np.diag(H), 1e-12))
    inner = np.linalg.pinv(H * s[:, None] * s, hermitian=True, rcond=1e-13)
    covariance = variance * inner * s[:, None] * s
    return Adjusted(state, residuals, float(np.sqrt(variance)), covariance, converged)
