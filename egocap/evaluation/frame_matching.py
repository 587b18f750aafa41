"""Predictions matched to a sequence's frames and moved to the head frame.

Duplicated, unknown or missing frames and an implausible size are errors. Where another frame of
reference, or left and right exchanged, would explain the error, there is only a warning.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.labels import MIRROR
from egocap.cameras.rig import Rig
from egocap.errors import InputError
from egocap.evaluation.predictions import UNITS, Predictions
from egocap.geometry import inverse, transform
from egocap.series import nearest, runs

log = logging.getLogger(__name__)

Missing = Literal["refuse", "skip"]
LARGEST_RATIO = 5.0  # of a predicted person's size to the true one's; a poor method stays below
SAME_TIME_S = 1e-3


def match_frames(
    predictions: Predictions, times: Float[Array, "T"], missing: Missing = "refuse"
) -> tuple[Float[Array, "T 18 3"], Bool[Array, "T 18"]]:
    """Positions and validity for every frame of a sequence, in the predictions' own frame.

    Raises:
        InputError: a frame is repeated, is not in the sequence, or is missing (unless `missing` is
            "skip": then it counts as not predicted).
    """
    rows = _rows(predictions, np.asarray(times, np.float64))
    seen, counts = np.unique(rows, return_counts=True)
    if (counts > 1).any():
        raise InputError(f"repeated frames: {_ranges(seen[counts > 1])}", valid="each frame once")
    absent = np.setdiff1d(np.arange(len(times)), rows)
    if len(absent) and missing == "refuse":
        raise InputError(
            f"{len(absent)} of {len(times)} frames are missing: {_ranges(absent)}",
            valid="all frames, or --missing skip to score the others",
        )
    positions = np.zeros((len(times), *predictions.positions.shape[1:]))
    valid = np.zeros(positions.shape[:2], bool)
    positions[rows], valid[rows] = predictions.positions, predictions.valid
    return positions, valid


def to_head_frame(
    positions: Float[Array, "T 18 3"],
    frame: str,
    rig: Rig,
    T_world_head: Float[Array, "T 4 4"],
) -> Float[Array, "T 18 3"]:
    """Positions in the head frame.

    From the world by the true head pose: distances to the truth are the same in both frames. From
    a camera by the rig as trackers know it.

    Raises:
        InputError: the rig has no such camera.
    """
    if frame == "head":
        return positions
    if frame == "world":
        return transform(inverse(T_world_head), positions)
    view = frame.removeprefix("camera:")
    if view not in rig.views:
        raise InputError(f"no camera '{view}'", valid=[f"camera:{name}" for name in rig.views])
    return transform(rig.mounts[rig.views.index(view)].T_head_camera, positions)


def require_plausible_size(
    positions: Float[Array, "T 18 3"],
    valid: Bool[Array, "T 18"],
    truth: Float[Array, "T 18 3"],
    unit: str,
) -> None:
    """InputError for a size that no person has; it names the unit that would explain it."""
    size, true_size = _extent(positions, valid), _extent(truth, valid)
    if not (size > 0 and true_size > 0):
        return
    ratio = size / true_size
    problem = f"the person spans {size:,.4g} m, the true one {true_size:.2f} m"
    for name, scale in UNITS.items():
        if name != unit and 0.75 < ratio * scale / UNITS[unit] < 1.33:
            raise InputError(f"{problem}; the stated unit is '{unit}'", valid=f"unit '{name}'")
    if not 1 / LARGEST_RATIO < ratio < LARGEST_RATIO:
        raise InputError(problem, valid="metres, centimetres or millimetres, as stated in 'unit'")


def warn_of_other_readings(
    positions: Float[Array, "T 18 3"],
    valid: Bool[Array, "T 18"],
    truth: Float[Array, "T 18 3"],
    frame: str,
    rig: Rig,
    T_world_head: Float[Array, "T 4 4"],
) -> list[str]:
    """Log and return which other reading of the predictions would halve the error.

    `positions` are as predicted, in the stated `frame`. Only that reading is scored.
    """

    def read_in(name: str, points: Array = positions) -> Array:
        return to_head_frame(points, name, rig, T_world_head)

    error = _mean_error(read_in(frame), valid, truth)
    if not error > 0.05:
        return []
    found = []
    for other in ("head", "world", *(f"camera:{view}" for view in rig.views)):
        if other == frame:
            continue
        other_error = _mean_error(read_in(other), valid, truth)
        if other_error < 0.5 * error:
            found.append(
                f"in the stated frame '{frame}' the joints are {1e3 * error:.0f} mm off; "
                f"in '{other}' they would be {1e3 * other_error:.0f} mm off"
            )
    mirror = list(MIRROR)
    errors = {
        "left and right exchanged": _mean_error(read_in(frame)[:, mirror], valid[:, mirror], truth)
    }
    for axis, name in enumerate("xyz"):
        flipped = np.where(np.arange(3) == axis, -positions, positions)
        errors[f"the sign of {name} changed"] = _mean_error(read_in(frame, flipped), valid, truth)
    best = min(errors, key=lambda change: errors[change])
    if errors[best] < 0.5 * error:
        found.append(f"with {best} the joints would be {1e3 * errors[best]:.0f} "
                     f"mm off instead of {1e3 * error:.0f}")  # fmt: skip
    for warning in found:
        log.warning("%s", warning)
    return found


def _rows(predictions: Predictions, times: Array) -> Array:
    if predictions.frames is not None:
        unknown = np.setdiff1d(predictions.frames, np.arange(len(times)))
        if len(unknown):
            raise InputError(f"no such frames in the sequence: {_ranges(unknown)}",
                             valid=f"0 to {len(times) - 1}")  # fmt: skip
        return predictions.frames
    assert predictions.times is not None
    rows = nearest(times, predictions.times)
    apart = ~(np.abs(predictions.times - times[rows]) <= SAME_TIME_S)
    if apart.any():
        first = predictions.times[np.argmax(apart)]
        raise InputError(
            f"{int(apart.sum())} times belong to no frame, the first is {first:.4f} s",
            valid=f"{times[0]:g} to {times[-1]:g} s, {len(times)} frames",
        )
    return rows


def _extent(positions: Array, valid: Array) -> float:
    """Median over frames of the diagonal of the box around the joints."""
    low = np.where(valid[..., None], positions, np.inf).min(1)
    high = np.where(valid[..., None], positions, -np.inf).max(1)
    sizes = np.linalg.norm((high - low)[valid.sum(1) > 1], axis=-1)
    return float(np.median(sizes)) if len(sizes) else 0.0


def _mean_error(positions: Array, valid: Array, truth: Array) -> float:
    return float(np.linalg.norm(positions - truth, axis=-1)[valid].mean())


def _ranges(numbers: Iterable[int]) -> str:
    """Numbers with runs as ranges, the first few."""
    found = list(runs(np.asarray(numbers)))
    shown = [f"{run[0]}-{run[-1]}" if len(run) > 1 else str(run[0]) for run in found[:5]]
    return ", ".join(shown) + (", ..." if len(found) > 5 else "")
