"""Predictions brought to a sequence's frames and to the head frame, and doubted where they should.

What is refused: duplicated, unknown or missing frames, and a size that no person has. What is only
warned of: another frame of reference, or left and right exchanged, that would explain the error.
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

log = logging.getLogger(__name__)

Missing = Literal["refuse", "skip"]
LARGEST_RATIO = 5.0  # of a predicted person's size to the true one's; a poor method stays below
SAME_TIME_S = 1e-3


def on_frames(
    predictions: Predictions, times: Float[Array, "T"], missing: Missing = "refuse"
) -> tuple[Float[Array, "T 18 3"], Bool[Array, "T 18"]]:
    """Positions and validity for every frame of a sequence, in the predictions' own frame.

    Raises:
        InputError: a frame is there twice, is none of the sequence's, or is missing (unless
            `missing` is "skip": then it counts as not predicted).
    """
    rows = _rows(predictions, np.asarray(times, np.float64))
    seen, counts = np.unique(rows, return_counts=True)
    if (counts > 1).any():
        raise InputError(f"frames there twice: {_listed(seen[counts > 1])}", valid="each once")
    absent = np.setdiff1d(np.arange(len(times)), rows)
    if len(absent) and missing == "refuse":
        raise InputError(
            f"{len(absent)} of {len(times)} frames are missing: {_listed(absent)}",
            valid="all of them, or --missing skip, which scores the others and says how many",
        )
    positions = np.zeros((len(times), *predictions.positions.shape[1:]))
    valid = np.zeros(positions.shape[:2], bool)
    positions[rows], valid[rows] = predictions.positions, predictions.valid
    return positions, valid


def in_head_frame(
    positions: Float[Array, "T 18 3"],
    frame: str,
    rig: Rig,
    T_world_head: Float[Array, "T 4 4"],
) -> Float[Array, "T 18 3"]:
    """Positions in the head frame.

    From the world, with the true head pose: distances to the truth are the same in both. From a
    camera, with the rig as trackers know it.

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


def require_a_person(
    positions: Float[Array, "T 18 3"],
    valid: Bool[Array, "T 18"],
    truth: Float[Array, "T 18 3"],
    unit: str,
) -> None:
    """InputError for a size that no person has, naming the unit that would make it one."""
    size, true_size = _extent(positions, valid), _extent(truth, valid)
    if not (size > 0 and true_size > 0):
        return
    ratio = size / true_size
    fitting = [
        name for name, scale in UNITS.items()
        if name != unit and 0.75 < ratio * scale / UNITS[unit] < 1.33
    ]  # fmt: skip
    if fitting:
        raise InputError(
            f"the person spans {size:,.4g} m where the true one spans {true_size:.2f} m: the unit "
            f"is stated as '{unit}', in '{fitting[0]}' it would be {true_size:.2f} m or so",
            valid=f"unit '{fitting[0]}'",
        )
    if not 1 / LARGEST_RATIO < ratio < LARGEST_RATIO:
        raise InputError(
            f"the person spans {size:,.4g} m where the true one spans {true_size:.2f} m",
            valid="metres, centimetres or millimetres, as stated in 'unit'",
        )


def warn_of_mix_ups(
    positions: Float[Array, "T 18 3"],
    valid: Bool[Array, "T 18"],
    truth: Float[Array, "T 18 3"],
    frame: str,
    rig: Rig,
    T_world_head: Float[Array, "T 4 4"],
) -> list[str]:
    """Say (and log) which other reading would leave less than half of the error.

    `positions` are as predicted, in the frame stated. The reading asked for is scored anyway.
    """
    error = _mean_error(in_head_frame(positions, frame, rig, T_world_head), valid, truth)
    found = []
    for other in ("head", "world", *(f"camera:{view}" for view in rig.views)):
        if other != frame:
            other_error = _mean_error(
                in_head_frame(positions, other, rig, T_world_head), valid, truth
            )
            if other_error < 0.5 * error and error > 0.05:
                found.append(
                    f"stated in frame '{frame}', the joints are {1e3 * error:.0f} mm off; "
                    f"read in '{other}' they would be {1e3 * other_error:.0f}"
                )
    mirror = list(MIRROR)
    in_head = in_head_frame(positions, frame, rig, T_world_head)
    readings = {"left and right exchanged": (in_head[:, mirror], valid[:, mirror])}
    for axis, name in enumerate("xyz"):
        flipped = np.where(np.arange(3) == axis, -positions, positions)
        turned = in_head_frame(flipped, frame, rig, T_world_head)
        readings[f"the sign of {name} changed"] = (turned, valid)
    errors = {words: _mean_error(*reading, truth) for words, reading in readings.items()}
    best = min(errors, key=lambda words: errors[words])
    if errors[best] < 0.5 * error and error > 0.05:
        found.append(f"with {best} the joints would be {1e3 * errors[best]:.0f} "
                     f"mm off instead of {1e3 * error:.0f}")  # fmt: skip
    for warning in found:
        log.warning("%s", warning)
    return found


def _rows(predictions: Predictions, times: Array) -> Array:
    if predictions.frames is not None:
        unknown = np.setdiff1d(predictions.frames, np.arange(len(times)))
        if len(unknown):
            raise InputError(f"no such frames in the sequence: {_listed(unknown)}",
                             valid=f"0 to {len(times) - 1}")  # fmt: skip
        return predictions.frames
    assert predictions.times is not None
    rows = np.abs(predictions.times[:, None] - times).argmin(1)
    apart = ~(np.abs(predictions.times - times[rows]) <= SAME_TIME_S)
    if apart.any():
        first = int(np.argmax(apart))
        raise InputError(
            f"{int(apart.sum())} times are no frame's, the first {predictions.times[first]:.4f} s",
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


def _listed(numbers: Iterable[int]) -> str:
    """Numbers with runs as ranges, the first few."""
    runs: list[list[int]] = []
    for n in numbers:
        if runs and int(n) == runs[-1][1] + 1:
            runs[-1][1] = int(n)
        else:
            runs.append([int(n), int(n)])
    shown = [str(a) if a == b else f"{a}-{b}" for a, b in runs[:5]]
    return ", ".join(shown) + (", ..." if len(runs) > 5 else "")
