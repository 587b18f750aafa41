"""The lens model by cross-validation: fitted to some pictures, scored on the corners of others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.calibration.adjustment import (
    Adjusted,
    adjust,
    robust_scale,
    whitened,
)
from egocap.calibration.lens_shape import LensShape, convert
from egocap.calibration.state import Corners, State, residuals_of

FOLDS = 3
_BETTER = 0.995  # of a simpler model's error: what a model with more parameters must reach
_MARGIN = 0.08  # rad beyond the outermost corner over which lenses are converted


@dataclass(frozen=True, eq=False)
class Choice:
    """Candidates of one view with their held-out errors, and the one that is taken."""

    shape: LensShape
    held_out: dict[str, float]  # title: rms of held-out corners, pixels; inf where it failed


def choose_shape(
    fitted: Adjusted, corners: Corners, points: Float[Array, "K 3"], shapes: Sequence[LensShape]
) -> Choice:
    """Choose among shapes for a single view, from an adjustment of it with any of them.

    Shapes come from few parameters to many; a shape is taken if its held-out error is clearly lower
    than that of every one before it.
    """
    if len(shapes) == 1:
        return Choice(shapes[0], {})
    best, least, errors = shapes[0], np.inf, {}
    for shape in shapes:
        scale, pixels = _held_out(with_shape(fitted.state, shape, points), corners, points)
        errors[shape.title] = pixels
        if scale < _BETTER * least:
            best, least = shape, scale
    return Choice(best, errors)


def with_shape(state: State, shape: LensShape, points: Float[Array, "K 3"]) -> State:
    """A single view's state with its lens converted to another shape."""
    if shape == state.shapes[0]:
        return state
    lens = convert(state.shapes[0], state.lenses[0], shape, widest_angle(state, points) + _MARGIN)
    return State((shape,), (lens,), state.T_view_rig, state.T_rig_board)


def widest_angle(state: State, points: Float[Array, "K 3"]) -> float:
    """Largest angle [rad] off the axis of any board's centre, at least 60 degrees."""
    seen = state.T_rig_board @ np.append(points.mean(0), 1.0)
    theta = np.arctan2(np.hypot(seen[:, 0], seen[:, 1]), seen[:, 2])
    return float(np.clip(theta.max(initial=0.0), np.pi / 3, 1.9))


def _held_out(state: State, corners: Corners, points: Array) -> tuple[float, float]:
    """Robust whitened scale and rms pixels of corners held out, over all folds."""
    instants = np.unique(corners.instant)
    white, pixels = [], []
    for fold in range(FOLDS):
        out = np.isin(corners.instant, instants[fold::FOLDS])
        kept, tested = corners[~out], corners[out]
        fitted = adjust(state, kept, points)
        tested_state = State(state.shapes, fitted.state.lenses, state.T_view_rig, state.T_rig_board)
        scored = adjust(tested_state, tested, points, only_boards=True)
        residuals = residuals_of(scored.state, tested, points)
        if not np.isfinite(residuals).all():
            return np.inf, np.inf
        pixels.append(residuals)
        white.append(whitened(residuals, tested))
    scale = robust_scale(np.concatenate(white))
    length = np.linalg.norm(np.concatenate(white), axis=1)
    kept = length < 6 * scale
    return (float(np.sqrt(np.mean(length[kept] ** 2))),
            float(np.sqrt(np.mean(np.concatenate(pixels)[kept] ** 2))))  # fmt: skip
