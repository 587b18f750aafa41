"""Dataclasses of arrays as npz files of a stated layout: what detections and tracks share."""

from __future__ import annotations

import json
import zipfile
import zlib
from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy import ndarray as Array

from egocap.errors import FileError, MachineError

SCHEMA = 3
"""Version of both files. 2: detections may have `modes` and `mode_weights`; tracks the skeleton's
offsets, covariance, confidence, energies by term, and the world frame. 3: tracks may tell why a
joint is hidden."""

_OPTIONAL = {"modes", "mode_weights", "offsets", "covariance", "confidence", "energies",
             "T_world_head", "joints_world", "hidden"}  # fmt: skip
_FINITE = {"times", "angles", "joints_head", "offsets", "covariance", "confidence", "T_world_head",
           "joints_world"}  # fmt: skip
Layout = dict[str, tuple[str, tuple[str | int, ...]]]
"""Name of an array -> its dtype kind and shape; letters are free axes that must agree."""
Kind = TypeVar("Kind")


def save_result(path: Path, kind: str, result: Any) -> None:
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


def load_result(path: Path, kind: str, result: type[Kind], layout: Layout) -> Kind:
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
