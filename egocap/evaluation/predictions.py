"""Poses of any method in a neutral file: npz or JSON lines, with joints, unit and frame stated.

An npz archive holds

    format      "egocap-predictions"        version   1
    joints      (J,) names                  names     whose names they are: "egocap" (the default),
                                                      "unrealego", "ego4view", "mo2cap2"
    unit        "m", "cm" or "mm"           frame     "head", "world" or "camera:VIEW"
    positions   (T, J, 3) float32 or 64     frames    (T,) frame numbers from 0, or
    valid       (T, J) bool, optional       times     (T,) seconds
    method      what made them, optional    seconds_per_frame   optional

A JSON lines file holds the same: a first line {"format": "egocap-predictions", "version": 1,
"joints": [...], "unit": "m", "frame": "head"}, then one line a frame, {"frame": 0, "positions":
[[x, y, z], ...]} or {"time": 0.0, ...}, null standing for a joint that was not found.

Joints that are no label are left out; labels without a joint count as not predicted. Half-precision
positions are refused: at 1.6 m they are off by up to 0.5 mm, which shows in accelerations.
"""

from __future__ import annotations

import json
import logging
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from egocap.body.joint_names import DATASET_NAMES, label_of
from egocap.body.labels import LABELS
from egocap.errors import FileError, InputError

log = logging.getLogger(__name__)

FORMAT, VERSION = "egocap-predictions", 1
UNITS: Mapping[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}
SUFFIXES = (".npz", ".jsonl")
_FRAMES = "head, world or camera:VIEW"
_HEADER = ("format", "version", "joints", "unit", "frame", "names", "method", "seconds_per_frame")
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


def load_predictions(path: str | Path) -> Predictions:
    """Read a neutral file; FileError says what is wrong with it, where, and what would be valid."""
    path = Path(path)
    if path.suffix not in SUFFIXES:
        raise FileError(path, f"no format for '{path.suffix}'", valid=SUFFIXES)
    if not path.is_file():
        raise FileError(path, "is a folder" if path.is_dir() else "no such file")
    header, arrays = (_read_npz if path.suffix == ".npz" else _read_lines)(path)
    return _checked(path, header, arrays)


def save_predictions(path: str | Path, predictions: Predictions) -> None:
    """Write predictions with our labels in metres: .npz or .jsonl, whole or not at all."""
    from egocap.files import write_atomically

    path = Path(path)
    if path.suffix not in SUFFIXES:
        raise FileError(path, f"no format for '{path.suffix}'", valid=SUFFIXES)
    header: dict[str, Any] = {
        "format": FORMAT, "version": VERSION, "joints": list(LABELS), "unit": "m",
        "frame": predictions.frame, "method": predictions.method,
    }  # fmt: skip
    if predictions.seconds_per_frame is not None:
        header["seconds_per_frame"] = predictions.seconds_per_frame
    write_atomically(path, (_npz if path.suffix == ".npz" else _lines)(header, predictions))


def _npz(header: dict[str, Any], predictions: Predictions) -> bytes:
    import io

    arrays: dict[str, Any] = {
        **header, "positions": predictions.positions, "valid": predictions.valid,
        "frames": predictions.frames, "times": predictions.times,
    }  # fmt: skip
    content = io.BytesIO()
    np.savez_compressed(content, **{k: v for k, v in arrays.items() if v is not None})
    return content.getvalue()


def _lines(header: dict[str, Any], predictions: Predictions) -> bytes:
    lines = [json.dumps(header)]
    for i, (pose, valid) in enumerate(zip(predictions.positions, predictions.valid, strict=True)):
        number: dict[str, Any] = {}
        if predictions.frames is not None:
            number["frame"] = int(predictions.frames[i])
        if predictions.times is not None:
            number["time"] = float(predictions.times[i])
        points = [p.tolist() if found else None for p, found in zip(pose, valid, strict=True)]
        lines.append(json.dumps({**number, "positions": points}))
    return ("\n".join(lines) + "\n").encode()


def _read_npz(path: Path) -> tuple[dict[str, Any], dict[str, Array]]:
    try:
        if not zipfile.is_zipfile(path):
            raise ValueError
        with np.load(path, allow_pickle=False) as archive:
            found = {name: archive[name] for name in archive.files}
    except (ValueError, OSError, EOFError, KeyError, RuntimeError, NotImplementedError,
            zipfile.BadZipFile, zlib.error) as error:  # fmt: skip
        detail = f": {error}" if str(error) else ""
        raise FileError(path, f"not a whole npz archive of plain arrays{detail}") from None
    _known_keys(path, found, (*_HEADER, *_ARRAYS))
    header = {k: v.tolist() for k, v in found.items() if k in _HEADER}
    return header, {k: v for k, v in found.items() if k in _ARRAYS}


def _read_lines(path: Path) -> tuple[dict[str, Any], dict[str, Array]]:
    header: dict[str, Any] = {}
    poses, valid, numbers = [], [], {"frame": [], "time": []}
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(path, f"cannot be read: {error}") from None
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        record = _object(path, line, number)
        if not header:
            _known_keys(path, record, _HEADER, number)
            header = record
            continue
        _known_keys(path, record, ("frame", "time", "positions"), number)
        count = len(header["joints"]) if isinstance(header.get("joints"), list) else 0
        pose, there = _pose(path, record.get("positions"), count, number)
        poses.append(pose)
        valid.append(there)
        for name, values in numbers.items():
            if name in record:
                values.append(_number(path, record[name], name, number))
    arrays: dict[str, Array] = {
        "positions": np.stack(poses) if poses else np.zeros((0, 0, 3)),
        "valid": np.stack(valid) if poses else np.zeros((0, 0), bool),
    }
    for name, values in numbers.items():
        if values and len(values) != len(poses):
            raise FileError(path, f"not every line has a '{name}'", valid="one a frame")
        if values:
            arrays[f"{name}s"] = np.array(values)
    return header, arrays


def _object(path: Path, line: str, number: int) -> dict[str, Any]:
    try:
        record = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise FileError(path, f"not JSON: {error}", line=number) from None
    if not isinstance(record, dict):
        raise FileError(path, f"holds a {type(record).__name__}", line=number, valid="an object")
    return record


def _pose(path: Path, points: Any, count: int, line: int) -> tuple[Array, Array]:
    if not isinstance(points, list) or len(points) != count:
        found = len(points) if isinstance(points, list) else type(points).__name__
        raise FileError(path, f"{found} instead of {count} points", line=line, key="positions")
    there = np.array([point is not None for point in points], bool)
    pose = np.zeros((count, 3))
    for i, point in enumerate(points):
        if point is None:
            continue
        numbers = isinstance(point, list) and all(type(x) in (int, float) for x in point)
        if not numbers or len(point) != 3:
            raise FileError(path, f"point {i} is {point!r:.40}", line=line, key="positions",
                            valid="[x, y, z] or null")  # fmt: skip
        pose[i] = point
    return pose, there


def _number(path: Path, value: Any, name: str, line: int) -> float | int:
    if type(value) is int or (type(value) is float and name == "time"):
        return value
    raise FileError(path, f"{value!r:.40} is no number", line=line, key=name)


def _known_keys(path: Path, found: Mapping[str, Any], known: tuple[str, ...],
                line: int | None = None) -> None:  # fmt: skip
    for name in found:
        if name not in known:
            raise FileError(path, "unknown key", line=line, key=name, valid=known)


def _checked(path: Path, header: Mapping[str, Any], arrays: Mapping[str, Array]) -> Predictions:
    names, scale = _check_header(path, header)
    positions = arrays.get("positions")
    if positions is None:
        raise FileError(path, "missing", key="positions")
    if positions.dtype.kind != "f" or positions.dtype.itemsize < 4:
        valid_types = "float32 or float64: half precision is off by up to 0.5 mm"
        raise FileError(path, f"has type {positions.dtype}", key="positions", valid=valid_types)
    count = len(positions) if positions.ndim == 3 else "T"
    if positions.shape != (count, len(names), 3) or not len(positions):
        raise FileError(path, f"has shape {positions.shape}", key="positions",
                        valid=f"(frames, {len(names)} joints, 3)")  # fmt: skip
    valid = arrays.get("valid", np.ones(positions.shape[:2], bool))
    if valid.shape != positions.shape[:2] or valid.dtype.kind != "b":
        raise FileError(path, f"has shape {valid.shape} of {valid.dtype}", key="valid",
                        valid=f"{positions.shape[:2]} of bool")  # fmt: skip
    _check_finite(path, positions, valid, names)
    frames, times = _check_numbers(path, arrays, len(positions))
    try:
        found = label_of(names, header.get("names", "egocap"))
    except InputError as error:
        raise FileError(path, str(error), key="joints") from None
    unused = [name for i, name in enumerate(names) if i not in found]
    own = DATASET_NAMES[header.get("names", "egocap")].values()
    absent = [label for label in own if LABELS.index(label) not in found.values()]
    if unused and absent:  # either alone is another method's choice, both are a misspelling
        log.warning("%s: without %s; not known: %s", path, ", ".join(absent), ", ".join(unused))
    placed, there = (
        np.zeros((len(positions), len(LABELS), 3)),
        np.zeros((len(positions), len(LABELS)), bool),
    )
    for theirs, label in found.items():
        placed[:, label] = scale * positions[:, theirs].astype(np.float64)
        there[:, label] = valid[:, theirs]
    seconds = header.get("seconds_per_frame")
    return Predictions(
        placed, there, header["frame"], header["unit"], frames, times,
        method=str(header.get("method", "")),
        seconds_per_frame=None if seconds is None else float(seconds),
    )  # fmt: skip


def _check_header(path: Path, header: Mapping[str, Any]) -> tuple[list[str], float]:
    if header.get("format") != FORMAT:
        raise FileError(path, "not predictions", key="format", valid=FORMAT)
    if header.get("version") != VERSION:
        raise FileError(path, f"{header.get('version')!r}", key="version", valid=str(VERSION))
    for key in ("joints", "unit", "frame"):
        if key not in header:
            raise FileError(path, "missing: it must be stated", key=key)
    if header["unit"] not in UNITS:
        raise FileError(path, f"{header['unit']!r}", key="unit", valid=UNITS)
    frame = header["frame"]
    if frame not in ("head", "world") and not str(frame).startswith("camera:"):
        raise FileError(path, f"{frame!r}", key="frame", valid=_FRAMES)
    if header.get("names", "egocap") not in DATASET_NAMES:
        raise FileError(path, f"{header['names']!r}", key="names", valid=DATASET_NAMES)
    seconds = header.get("seconds_per_frame")
    if seconds is not None and not (type(seconds) in (int, float) and 0 < seconds < np.inf):
        raise FileError(path, f"{seconds!r}", key="seconds_per_frame", valid="a number above 0")
    names = header["joints"]
    if not isinstance(names, list) or not all(isinstance(n, str) for n in names):
        raise FileError(path, "not a list of names", key="joints")
    return names, UNITS[header["unit"]]


def _check_finite(path: Path, positions: Array, valid: Array, names: list[str]) -> None:
    bad = np.argwhere(~np.isfinite(positions).all(-1) & valid)
    if len(bad):
        row, joint = bad[0]
        raise FileError(
            path,
            f"not finite for {names[joint]} in row {row} (in {len(bad)} places altogether)",
            key="positions",
            valid="finite numbers; 'valid' false (null in JSON lines) for joints not found",
        )


def _check_numbers(
    path: Path, arrays: Mapping[str, Array], count: int
) -> tuple[Array | None, Array | None]:
    frames, times = arrays.get("frames"), arrays.get("times")
    if frames is None and times is None:
        raise FileError(path, "neither frame numbers nor times", key="frames", valid="one of them")
    for key, array, kinds in (("frames", frames, "iu"), ("times", times, "f")):
        if array is not None and (array.shape != (count,) or array.dtype.kind not in kinds):
            what = "whole numbers" if key == "frames" else "seconds"
            raise FileError(path, f"has shape {array.shape} of {array.dtype}", key=key,
                            valid=f"({count},) of {what}")  # fmt: skip
    return frames, times
