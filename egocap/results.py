"""What the stages hand on: detections and tracks, in memory and as npz files."""

from __future__ import annotations

import json
import zipfile
import zlib
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from egocap.errors import FileError, MachineError

SCHEMA = 3
"""Version of both files. 2: detections may have `modes` and `mode_weights`; tracks the skeleton's
offsets, covariance, confidence, energies by term, and the world frame. 3: tracks may tell why a
joint is hidden."""

ENERGY_TERMS: tuple[str, ...] = ("detection", "prior", "smoothness", "colour")
"""What `Track.energies` holds of every frame: equation 1's terms; the limits count as prior."""

HIDDEN: tuple[str, ...] = ("seen", "out of view", "own body", "object or unknown")
"""What the codes of `Track.hidden` mean; the same as a simulated truth's visibility."""


@dataclass(frozen=True, eq=False)
class Detections:
    """Body parts found in every view, in pixels of the rig's own image size.

    A missing detection has `valid` False; its other values mean nothing. A joint that the camera
    does not see but whose place was guessed is a detection too: low `confidence`, wide `sigma`.
    """

    times: Float[Array, "T"]  # seconds
    points: Float[Array, "T V 18 2"]  # pixels
    sigma: Float[Array, "T V 18"]  # standard deviation of a point along each axis, pixels
    confidence: Float[Array, "T V 18"]  # probability that the camera sees the joint
    valid: Bool[Array, "T V 18"]  # a detection was made, of a seen joint or of a hidden one
    source: str  # how they were made, e.g. "simulated:2.0"
    modes: Float[Array, "T V 18 K 2"] | None = None  # pixels, where else it may be; likeliest first
    mode_weights: Float[Array, "T V 18 K"] | None = None  # of each mode, 0 for none; sum up to 1

    def __getitem__(self, rows: slice) -> Detections:
        """Detections of some of the frames; arrays are views of these."""
        arrays = {name: a[rows] for name, a in vars(self).items() if isinstance(a, np.ndarray)}
        return replace(self, **arrays)

    @property
    def candidates(self) -> tuple[Float[Array, "T V 18 K 2"], Float[Array, "T V 18 K"]]:
        """Modes and their weights; the point alone, with weight 1, where no modes were kept."""
        if self.modes is None or self.mode_weights is None:
            return self.points[..., None, :], self.valid[..., None].astype(float)
        return self.modes, self.mode_weights


@dataclass(frozen=True, eq=False)
class Track:
    """A tracked motion in the head frame."""

    times: Float[Array, "T"]
    angles: Float[Array, "T 37"]  # radians, `egocap.skeleton.DOFS`
    joints_head: Float[Array, "T 18 3"]  # metres, `egocap.labels.LABELS`
    energy: Float[Array, "T"]  # final energy of each frame's fit
    converged: Bool[Array, "T"]
    detections_used: Float[Array, "T"]  # how many detections each frame had
    seconds_per_frame: float  # solver time, one core
    config: dict[str, object]  # solver and detection settings, time by stage, JSON-ready
    offsets: Float[Array, "22 3"] | None = None  # rest offsets of the skeleton that was tracked, m
    covariance: Float[Array, "T 18 3 3"] | None = None  # of joints_head, m^2
    confidence: Float[Array, "T 18"] | None = None  # chance that a joint is within 5 cm, 0 to 1
    energies: Float[Array, "T 4"] | None = None  # by term, `ENERGY_TERMS`
    T_world_head: Float[Array, "T 4 4"] | None = None  # where the head pose is known
    joints_world: Float[Array, "T 18 3"] | None = None  # metres, where the head pose is known
    hidden: UInt8[Array, "T V 18"] | None = None  # why a view does not see a joint, `HIDDEN`


_DETECTIONS = {
    "times": ("f", ("T",)), "points": ("f", ("T", "V", 18, 2)), "sigma": ("f", ("T", "V", 18)),
    "confidence": ("f", ("T", "V", 18)), "valid": ("b", ("T", "V", 18)), "source": ("U", ()),
    "modes": ("f", ("T", "V", 18, "K", 2)), "mode_weights": ("f", ("T", "V", 18, "K")),
}  # fmt: skip
_TRACK = {
    "times": ("f", ("T",)), "angles": ("f", ("T", 37)), "joints_head": ("f", ("T", 18, 3)),
    "energy": ("f", ("T",)), "converged": ("b", ("T",)), "detections_used": ("f", ("T",)),
    "seconds_per_frame": ("f", ()), "config": ("U", ()), "offsets": ("f", (22, 3)),
    "covariance": ("f", ("T", 18, 3, 3)), "confidence": ("f", ("T", 18)),
    "energies": ("f", ("T", len(ENERGY_TERMS))), "T_world_head": ("f", ("T", 4, 4)),
    "joints_world": ("f", ("T", 18, 3)), "hidden": ("u", ("T", "V", 18)),
}  # fmt: skip
_OPTIONAL = {"modes", "mode_weights", "offsets", "covariance", "confidence", "energies",
             "T_world_head", "joints_world", "hidden"}  # fmt: skip
_FINITE = {"times", "angles", "joints_head", "offsets", "covariance", "confidence", "T_world_head",
           "joints_world"}  # fmt: skip
_Layout = dict[str, tuple[str, tuple[str | int, ...]]]
_Kind = TypeVar("_Kind", Detections, Track)


def save_detections(path: str | Path, detections: Detections) -> None:
    """Write detections as npz, whole or not at all."""
    _save(Path(path), "egocap-detections", detections)


def load_detections(path: str | Path) -> Detections:
    """Read detections; FileError names the array that is missing, damaged, of a wrong shape, or
    holds something impossible for a valid detection."""
    found = _load(Path(path), "egocap-detections", Detections, _DETECTIONS)
    if (found.modes is None) != (found.mode_weights is None):
        raise FileError(path, "has one of 'modes' and 'mode_weights'", valid="both or none")
    modes, weights = found.candidates
    total = np.where(np.isfinite(weights) & (weights >= 0.0), weights, np.inf).sum(-1)
    placed = (np.isfinite(modes).all(-1) | ~(weights > 0.0)).all(-1)
    for name, good, valid in (
        ("points", np.isfinite(found.points).all(-1), "finite pixels"),
        ("sigma", np.isfinite(found.sigma) & (found.sigma >= 0.0), "finite pixels, 0 or more"),
        ("confidence", (found.confidence >= 0.0) & (found.confidence <= 1.0), "0 to 1"),
        ("modes", placed, "finite pixels where the weight is not 0"),
        ("mode_weights", total <= 1.0 + 1e-6, "0 or more, adding up to 1 at most"),
    ):
        bad = np.argwhere(found.valid & ~good)
        if len(bad):
            frame, view, joint = bad[0]
            what = f"wrong for label {joint} in view {view} of frame {frame}"
            raise FileError(path, what, key=name, valid=f"{valid} wherever 'valid' is true")
    return found


def save_track(path: str | Path, track: Track) -> None:
    """Write a track as npz, whole or not at all."""
    _save(Path(path), "egocap-track", track)


def load_track(path: str | Path) -> Track:
    """Read a track; FileError names the array that is missing, damaged or of a wrong shape."""
    found = _load(Path(path), "egocap-track", Track, _TRACK)
    if found.hidden is not None and found.hidden.max(initial=0) >= len(HIDDEN):
        raise FileError(path, f"holds the cause {found.hidden.max()}", key="hidden",
                        valid=f"0 to {len(HIDDEN) - 1}")  # fmt: skip
    return found


def _save(path: Path, kind: str, result: Detections | Track) -> None:
    arrays: dict[str, Any] = {f.name: getattr(result, f.name) for f in fields(result)}
    arrays = {name: value for name, value in arrays.items() if value is not None}
    if "config" in arrays:
        arrays["config"] = json.dumps(arrays["config"])
    # Renamed into place, so that a kill never leaves half a file under the real name.
    part = path.with_name(path.name + ".part")
    try:
        with part.open("wb") as file:
            np.savez_compressed(file, kind=kind, schema_version=SCHEMA, **arrays)
        part.replace(path)
    except IsADirectoryError:
        _drop(part)
        raise FileError(path, "is a folder", valid="the name of a file") from None
    except OSError as error:
        _drop(part)
        raise MachineError(f"cannot write {path}: {error.strerror}") from None


def _drop(part: Path) -> None:
    with suppress(OSError):  # what could not be written may not be removable either
        part.unlink(missing_ok=True)


def _load(path: Path, kind: str, result: type[_Kind], layout: _Layout) -> _Kind:
    arrays = _read(path)
    found = arrays.pop("kind", np.array("another kind of data"))
    if str(found) != kind:
        raise FileError(path, f"holds {found}", key="kind", valid=kind)
    version = arrays.pop("schema_version", np.array(-1))
    if version.shape != () or version.dtype.kind not in "iu" or int(version) < 1:
        raise FileError(path, "not a version number", key="schema_version", valid=str(SCHEMA))
    if int(version) > SCHEMA:
        raise FileError(
            path, f"written by a newer version (schema {int(version)})", key="schema_version",
            valid=f"up to {SCHEMA}",
        )  # fmt: skip
    for name in arrays:
        if name not in layout:
            raise FileError(path, "unknown array", key=name, valid=layout)
    sizes: dict[str, int] = {}
    for name, (dtype_kind, shape) in layout.items():
        if name in arrays:
            _check(path, name, arrays[name], dtype_kind, shape, sizes)
        elif name not in _OPTIONAL:
            raise FileError(path, "missing", key=name)
    return result(**{n: _value(path, n, arrays[n]) for n in layout if n in arrays})


def _read(path: Path) -> dict[str, Array]:
    if not path.is_file():
        raise FileError(path, "is a directory" if path.is_dir() else "no such file")
    try:
        if not zipfile.is_zipfile(path):  # np.load would take other kinds of file too
            raise ValueError
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (ValueError, OSError, EOFError, KeyError, NotImplementedError, RuntimeError,
            zipfile.BadZipFile, zlib.error) as error:  # fmt: skip
        detail = f": {error}" if str(error) else ""
        raise FileError(path, f"not a whole npz archive of plain arrays{detail}") from None


def _check(
    path: Path, name: str, array: Array, kind: str, shape: tuple[str | int, ...],
    sizes: dict[str, int],
) -> None:  # fmt: skip
    """Raise FileError unless the array has the kind and shape; letters must agree among arrays."""
    expected = (
        "(" + ", ".join(str(sizes.get(n, n) if isinstance(n, str) else n) for n in shape) + ")"
    )
    if array.dtype.kind != kind:
        names = {
            "f": "floating-point numbers",
            "b": "booleans",
            "U": "text",
            "u": "whole numbers from 0",
        }
        raise FileError(path, f"has type {array.dtype}", key=name, valid=names[kind])
    if array.ndim != len(shape):
        raise FileError(path, f"has shape {array.shape}", key=name, valid=expected)
    for n, size in zip(shape, array.shape, strict=True):
        if size != (sizes.setdefault(n, size) if isinstance(n, str) else n):
            raise FileError(path, f"has shape {array.shape}", key=name, valid=expected)


def _value(path: Path, name: str, array: Array) -> Any:
    if name == "config":
        try:
            config = json.loads(str(array))
        except json.JSONDecodeError as error:
            raise FileError(path, f"not valid JSON: {error.msg}", key=name) from None
        if not isinstance(config, dict):
            raise FileError(path, "not a JSON object", key=name)
        return config
    if array.shape == ():
        return array.item()
    if array.dtype.kind == "f" and name in _FINITE and not np.isfinite(array).all():
        raise FileError(path, "holds values that are not finite", key=name)
    return array
