"""Checks of shapes, finite values and frame times of inputs."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.labels import LABELS
from egocap.errors import InputError


def require_shape(points: Array, shape: tuple[str | int, ...], what: str) -> None:
    """Raise InputError unless the array has a shape; strings in `shape` name free axes."""
    fits = points.ndim == len(shape) and all(
        isinstance(n, str) or n == m for n, m in zip(shape, points.shape, strict=True)
    )
    if not fits:
        valid = f"({', '.join(map(str, shape))})"
        raise InputError(f"{what} have shape {points.shape}", valid=valid)


def require_finite(
    points: Float[Array, "T *axes 18 C"], what: str, where: Bool[Array, "T *axes 18"] | None = None
) -> None:
    """Raise InputError with the first frame and joint whose coordinates are NaN or infinite.

    `where` restricts the check to entries that are used.
    """
    bad = ~np.isfinite(points).all(-1)
    if where is not None:
        bad &= where
    if bad.any():
        frame, *view, joint = (int(i) for i in np.argwhere(bad)[0])
        place = f"frame {frame}" + (f", view {view[0]}" if view else "") + f", {LABELS[joint]}"
        raise InputError(
            f"{what} are not finite at {place} ({int(bad.sum())} in total)",
            valid="finite numbers",
        )


def require_same_times(
    times: Float[Array, "T"], truth_times: Float[Array, "T"], what: str, tolerance: float = 1e-3
) -> None:
    """Raise InputError unless both have the same frame times (to `tolerance` seconds)."""
    if len(times) != len(truth_times):
        raise InputError(
            f"{what} has {len(times)} frames, the sequence {len(truth_times)}",
            valid="made from this very sequence",
        )
    apart = ~(np.abs(np.asarray(times) - truth_times) <= tolerance)  # also true for NaN
    if apart.any():
        frame = int(np.argmax(apart))
        raise InputError(
            f"{what} and the sequence are at different times in frame {frame}: "
            f"{times[frame]:.4f} s and {truth_times[frame]:.4f} s",
            valid="made from this very sequence",
        )
