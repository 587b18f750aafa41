"""Poses of any method in a neutral file: npz or JSON lines, with joints, unit and frame stated.

An npz archive holds

    format      "egocap-predictions"        version   1
    joints      (J,) names                  names     whose names they are: "egocap" (the default),
                                                      "unrealego", "ego4view", "mo2cap2"
    unit        "m", "cm" or "mm"           frame     "head", "world" or "camera:VIEW"
    positions   (T, J, 3) float32 or 64     frames    (T,) frame numbers from 0, or
    valid       (T, J) bool, optional       times     (T,) seconds
    method      name, optional              seconds_per_frame   optional

A JSON lines file holds the same: a first line {"format": "egocap-predictions", "version": 1,
"joints": [...], "unit": "m", "frame": "head"}, then one line a frame, {"frame": 0, "positions":
[[x, y, z], ...]} or {"time": 0.0, ...}, null standing for a joint that was not found.

Joints that are no label are left out; labels without a joint count as not predicted. Half-precision
positions are refused: at 1.6 m they are off by up to 0.5 mm, which shows in accelerations.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from pydantic import AfterValidator, Field

from egocap.body.joint_names import DATASET_NAMES, match_labels
from egocap.body.labels import LABELS
from egocap.data.input_checks import require_shape
from egocap.errors import FileError, InputError
from egocap.files import LARGEST, read_npz, usable, write_atomically, write_npz
from egocap.schema import Number, Strict, checked, parsed, read_text

log = logging.getLogger(__name__)

FORMAT, VERSION = "egocap-predictions", 1
UNITS: Mapping[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}
SUFFIXES = (".npz", ".jsonl")
_ARRAYS = ("positions", "frames", "times", "valid")


@dataclass(frozen=True, eq=False)
class Predictions:
    """Poses in metres, on the labels; axis N is the file's own frames, in its order."""

    positions: Float[Array, "N 18 3"]  # metres; meaningful where `valid`
    valid: Bool[Array, "N 18"]
    frame: str  # "head", "world" or "camera:VIEW"
    unit: str  # as the file stated it
    frames: Int[Array, "N"] | None = None  # numbers of the sequence's frames; or times
    times: Float[Array, "N"] | None = None  # seconds
    method: str = ""
    seconds_per_frame: float | None = None

    @classmethod
    def from_joints(
        cls,
        joints: Float[Array, "T 18 3"],
        method: str = "",
        seconds_per_frame: float | None = None,
    ) -> Predictions:
        """Joints of every frame of a sequence in the head frame, metres; NaN where not found.

        Raises InputError for another shape.
        """
        joints = np.asarray(joints, np.float64)
        require_shape(joints, ("T", len(LABELS), 3), "joints")
        valid, frames = np.asarray(np.isfinite(joints).all(-1)), np.arange(len(joints))
        placed = np.where(valid[..., None], joints, 0.0)
        return cls(placed, valid, "head", "m", frames, None, method, seconds_per_frame)


def _known_frame(name: str) -> str:
    if name not in ("head", "world") and not name.startswith("camera:"):
        raise ValueError("should be head, world or camera:VIEW")
    return name


def _known_names(name: str) -> str:
    if name not in DATASET_NAMES:
        raise ValueError(f"should be one of {', '.join(DATASET_NAMES)}")
    return name


class _Header(Strict):
    format: Literal["egocap-predictions"]
    version: Literal[1]
    joints: list[str]
    unit: Literal["m", "cm", "mm"]
    frame: Annotated[str, AfterValidator(_known_frame)]
    names: Annotated[str, AfterValidator(_known_names)] = "egocap"
    method: str = ""
    seconds_per_frame: float | None = Field(None, ge=1e-9, le=1e9)


class _Line(Strict):
    positions: list[Annotated[list[Number], Field(min_length=3, max_length=3)] | None]
    frame: Annotated[int, Field(strict=True)] | None = None
    time: Number | None = None


def load_predictions(path: str | Path) -> Predictions:
    """Read a neutral file. FileError names the key or line that is wrong, and what is valid."""
    path = Path(path)
    _check_suffix(path)
    header, arrays = (_read_npz if path.suffix == ".npz" else _read_lines)(path)
    return _checked(path, header, arrays)


def save_predictions(path: str | Path, predictions: Predictions) -> None:
    """Write predictions with our labels in metres: .npz or .jsonl, whole or not at all."""
    path = Path(path)
    _check_suffix(path)
    header: dict[str, Any] = {
        "format": FORMAT, "version": VERSION, "joints": list(LABELS), "unit": "m",
        "frame": predictions.frame, "method": predictions.method,
    }  # fmt: skip
    if predictions.seconds_per_frame is not None:
        header["seconds_per_frame"] = predictions.seconds_per_frame
    if path.suffix == ".npz":
        write_npz(path, **header, **{name: getattr(predictions, name) for name in _ARRAYS})
    else:
        write_atomically(path, _to_lines(header, predictions))


def _check_suffix(path: Path) -> None:
    if path.suffix not in SUFFIXES:
        raise FileError(path, f"no format for '{path.suffix}'", valid=SUFFIXES)


def _to_lines(header: dict[str, Any], predictions: Predictions) -> str:
    lines = [json.dumps(header)]
    for i, (pose, valid) in enumerate(zip(predictions.positions, predictions.valid, strict=True)):
        record: dict[str, Any] = {}
        if predictions.frames is not None:
            record["frame"] = int(predictions.frames[i])
        if predictions.times is not None:
            record["time"] = float(predictions.times[i])
        points = [p.tolist() if found else None for p, found in zip(pose, valid, strict=True)]
        lines.append(json.dumps({**record, "positions": points}))
    return "\n".join(lines) + "\n"


def _read_npz(path: Path) -> tuple[_Header, dict[str, Array]]:
    found = read_npz(path)
    known = [*_Header.model_fields, *_ARRAYS]
    for name in found:
        if name not in known:
            raise FileError(path, "unknown key", key=name, valid=known)
    header = {k: v.tolist() for k, v in found.items() if k not in _ARRAYS}
    return checked(_Header, header, path), {k: v for k, v in found.items() if k in _ARRAYS}


def _read_lines(path: Path) -> tuple[_Header, dict[str, Array]]:
    numbered = [(i, t) for i, t in enumerate(read_text(path).splitlines(), 1) if t.strip()]
    first, text = numbered[0] if numbered else (1, "{}")
    header = checked(_Header, parsed(text, path, line=first), path, line=first)
    lines = [checked(_Line, parsed(t, path, line=i), path, line=i) for i, t in numbered[1:]]
    for (i, _), line in zip(numbered[1:], lines, strict=True):
        if len(line.positions) != len(header.joints):
            problem = f"{len(line.positions)} instead of {len(header.joints)} points"
            raise FileError(path, problem, line=i, key="positions")
    points = [[point or (0.0, 0.0, 0.0) for point in line.positions] for line in lines]
    arrays: dict[str, Array] = {
        "positions": np.array(points, float).reshape(len(lines), len(header.joints), 3),
        "valid": np.array([[p is not None for p in line.positions] for line in lines], bool),
    }
    for name in ("frame", "time"):
        values = [getattr(line, name) for line in lines if getattr(line, name) is not None]
        if values and len(values) != len(lines):
            raise FileError(path, f"not every line has a '{name}'", valid="one a frame")
        if values:
            arrays[f"{name}s"] = np.array(values)
    return header, arrays


def _checked(path: Path, header: _Header, arrays: Mapping[str, Array]) -> Predictions:
    names = header.joints
    positions, valid = _checked_positions(path, arrays, names)
    frames, times = _checked_numbers(path, arrays, len(positions))
    try:
        found = match_labels(names, header.names)
    except InputError as error:
        raise FileError(path, str(error), key="joints") from None
    unused = [name for i, name in enumerate(names) if i not in found]
    own = DATASET_NAMES[header.names].values()
    absent = [label for label in own if LABELS.index(label) not in found.values()]
    if unused and absent:  # either alone may be intended, both together are a misspelling
        log.warning("%s: without %s; unknown: %s", path, ", ".join(absent), ", ".join(unused))
    placed = np.zeros((len(positions), len(LABELS), 3))
    there = np.zeros(placed.shape[:2], bool)
    for theirs, label in found.items():
        placed[:, label] = UNITS[header.unit] * positions[:, theirs].astype(np.float64)
        there[:, label] = valid[:, theirs]
    return Predictions(
        placed, there, header.frame, header.unit, frames, times, header.method,
        header.seconds_per_frame,
    )  # fmt: skip


def _checked_positions(
    path: Path, arrays: Mapping[str, Array], names: list[str]
) -> tuple[Array, Array]:
    positions = arrays.get("positions")
    if positions is None:
        raise FileError(path, "missing", key="positions")
    if positions.dtype.kind != "f" or positions.dtype.itemsize < 4:
        valid_types = "float32 or float64: half precision is off by up to 0.5 mm"
        raise FileError(path, f"has type {positions.dtype}", key="positions", valid=valid_types)
    if positions.ndim != 3 or positions.shape[1:] != (len(names), 3) or not len(positions):
        raise FileError(path, f"has shape {positions.shape}", key="positions",
                        valid=f"(frames, {len(names)} joints, 3)")  # fmt: skip
    valid = arrays.get("valid", np.ones(positions.shape[:2], bool))
    if valid.shape != positions.shape[:2] or valid.dtype.kind != "b":
        raise FileError(path, f"has shape {valid.shape} of {valid.dtype}", key="valid",
                        valid=f"{positions.shape[:2]} of bool")  # fmt: skip
    bad = np.argwhere(~usable(positions).all(-1) & valid)
    if len(bad):
        row, joint = bad[0]
        raise FileError(
            path,
            f"not finite, or too large, for {names[joint]} in row {row} (in {len(bad)} places)",
            key="positions",
            valid=f"up to {LARGEST:g}; 'valid' false (null in JSON lines) for joints not found",
        )
    return np.where(valid[..., None], positions, 0.0), valid


def _checked_numbers(
    path: Path, arrays: Mapping[str, Array], count: int
) -> tuple[Array | None, Array | None]:
    frames, times = arrays.get("frames"), arrays.get("times")
    if frames is None and times is None:
        raise FileError(path, "neither frame numbers nor times", key="frames", valid="one of them")
    for key, array, kinds, what in (
        ("frames", frames, "iu", "whole numbers"), ("times", times, "f", "seconds")
    ):  # fmt: skip
        if array is not None and (array.shape != (count,) or array.dtype.kind not in kinds):
            raise FileError(path, f"has shape {array.shape} of {array.dtype}", key=key,
                            valid=f"({count},) of {what}")  # fmt: skip
    return frames, times
