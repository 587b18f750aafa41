"""Dataclasses of arrays as npz files, validated by the shapes and types of their annotations.

`FrameArrays` is the base of simulated truth; `save_record` and `load_record` write and read
detections and tracks with a kind and a version. A field of type `X | None` may be missing.
"""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import NoneType
from typing import Any, NamedTuple, Self, TypeVar, get_args, get_type_hints

import numpy as np
from numpy import ndarray as Array

from egocap.errors import FileError
from egocap.files import LARGEST, read_npz, usable, write_atomically, write_npz
from egocap.schema import parsed

SCHEMA = 4
"""Version of detections and tracks. 2: detections may have `modes` and `mode_weights`; tracks the
skeleton's offsets, covariance, confidence, energies by term, and the world frame. 3: tracks may
have the cause of occlusion. 4: tracks may have contacts, and gaps in the world frame."""

_FINITE = {"times", "angles", "joints_head", "offsets", "covariance", "confidence", "T_world_head",
           "joints_world", "contacts", "draws", "joints", "chain"}  # fmt: skip
_TYPES = {
    "Float": ("f", "floating-point numbers"),
    "Bool": ("b", "booleans"),
    "UInt8": ("u", "whole numbers from 0"),
    "UInt32": ("u", "whole numbers from 0"),
    "Int64": ("i", "whole numbers"),
    "float": ("f", "floating-point numbers"),
    "int": ("i", "whole numbers"),
    "bool": ("b", "booleans"),
    "str": ("U", "text"),
    "dict": ("U", "text"),
    "tuple": ("U", "text"),
}
Record = TypeVar("Record")


class _Field(NamedTuple):
    kind: str  # of the dtype
    described: str
    shape: tuple[int | str, ...]  # letters: free axes, of equal size in all arrays
    optional: bool


@cache
def _layout(record: type) -> dict[str, _Field]:
    """The fields of a dataclass, by name."""
    layout = {}
    for name, hint in get_type_hints(record).items():
        optional = NoneType in get_args(hint)
        hint = get_args(hint)[0] if optional else hint
        axes = getattr(hint, "dim_str", "").split()
        shape = tuple(int(axis) if axis.isdecimal() else axis for axis in axes)
        kind = getattr(hint, "dtype", getattr(hint, "__origin__", hint)).__name__
        shape = (f"number of {name}",) if kind == "tuple" else shape
        layout[name] = _Field(*_TYPES[kind], shape, optional)
    return layout


@dataclass(frozen=True, eq=False)
class FrameArrays:
    """Base of records whose fields are all arrays of the same length T."""

    def save(self, path: Path) -> None:
        """Write `content` to a file, atomically."""
        write_atomically(path, self.content())

    def content(self) -> bytes:
        """An uncompressed npz archive; equal arrays give equal bytes."""
        file = io.BytesIO()
        with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
            for name in _layout(type(self)):
                entry = zipfile.ZipInfo(name + ".npy", date_time=(1980, 1, 1, 0, 0, 0))
                with archive.open(entry, "w") as member:
                    np.lib.format.write_array(member, getattr(self, name), allow_pickle=False)
        return file.getvalue()

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a file written by `save`. FileError names a missing or misshapen array."""
        return record_of(path, cls, read_npz(path))


def save_record(path: str | Path, kind: str, record: Any) -> None:
    """Write a dataclass of arrays, numbers, text and a `config` as npz, atomically."""
    arrays = {name: getattr(record, name) for name in _layout(type(record))}
    if "config" in arrays:
        arrays["config"] = json.dumps(arrays["config"])
    write_npz(Path(path), kind=kind, schema_version=SCHEMA, **arrays)


def load_record(path: str | Path, kind: str, record: type[Record]) -> Record:
    """Read a file of `save_record`. Raises FileError for other content or a newer version."""
    path = Path(path)
    arrays = read_npz(path)
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
    if unknown := [name for name in arrays if name not in _layout(record)]:
        raise FileError(path, "unknown array", key=unknown[0], valid=_layout(record))
    return record_of(path, record, arrays)


def record_of(path: Path, record: type[Record], arrays: dict[str, Array]) -> Record:
    """Make a record of a file's arrays; the type of each field says what is valid.

    Raises FileError for a missing array, a wrong type or shape.
    """
    sizes: dict[str, int] = {}
    values = {}
    for name, field in _layout(record).items():
        if name in arrays:
            _check(path, name, arrays[name], field, sizes)
            values[name] = _value(path, name, arrays[name])
        elif not field.optional:
            raise FileError(path, "missing", key=name)
    return record(**values)


def _check(path: Path, name: str, array: Array, field: _Field, sizes: dict[str, int]) -> None:
    if array.dtype.kind != field.kind:
        raise FileError(path, f"has type {array.dtype}", key=name, valid=field.described)
    expected = ", ".join(str(sizes.get(n, n) if isinstance(n, str) else n) for n in field.shape)
    fits = array.ndim == len(field.shape) and all(
        size == (sizes.setdefault(n, size) if isinstance(n, str) else n)
        for n, size in zip(field.shape, array.shape, strict=True)
    )
    if not fits:
        raise FileError(path, f"has shape {array.shape}", key=name, valid=f"({expected})")


def _value(path: Path, name: str, array: Array) -> Any:
    if name == "config":
        return parsed(str(array), path, key=name)
    if array.shape == ():
        return array.item()
    if array.dtype.kind == "U":
        return tuple(map(str, array))
    if array.dtype.kind == "f" and name in _FINITE and not usable(array).all():
        raise FileError(path, "holds values that are not finite, or too large", key=name,
                        valid=f"up to {LARGEST:g}")  # fmt: skip
    return array
