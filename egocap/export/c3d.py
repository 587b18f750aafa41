"""Joints as C3D, the file of biomechanics laboratories: millimetres, our axes (z up, x forward).

The smallest file that readers accept: a header, one block or more of parameters (the group POINT)
and points in 32-bit floats, little-endian. The residual of an unknown point is -1.

Source: The C3D File Format User Guide, Motion Lab Systems, 2008.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from egocap.data.track import Track
from egocap.errors import InputError
from egocap.export.markers import Markers, joint_markers
from egocap.files import write_atomically

_BLOCK = 512  # bytes
_MOST_FRAMES = 32767  # of a signed 16-bit count
_INTEL = 84  # processor type of little-endian files
_CHARACTER, _INTEGER, _FLOAT = -1, 2, 4  # types of parameters


def write_c3d(path: Path, track: Track) -> None:
    """Write a track as C3D, atomically.

    Raises InputError for more frames than the format counts, and as `egocap.files.disk_errors`.
    """
    markers = joint_markers(track)
    if len(markers.times) > _MOST_FRAMES:
        raise InputError(f"{len(markers.times)} frames in a C3D file", valid=f"to {_MOST_FRAMES}")
    size = len(_parameters(markers, 0))
    start = 2 + size // _BLOCK  # block of the data, counted from 1
    write_atomically(path, _header(markers, start) + _parameters(markers, start) + _data(markers))


def _header(markers: Markers, start: int) -> bytes:
    count, number = len(markers.times), len(markers.names)
    head = struct.pack("<BBHHHHHfHHf", 2, 0x50, number, 0, 1, count, 0, -1.0, start, 0, markers.fps)
    return head.ljust(_BLOCK, b"\0")


def _parameters(markers: Markers, start: int) -> bytes:
    """The parameter section, whole blocks; `start` is the block of the data."""
    names = [name.encode() for name in markers.names]
    width = max(map(len, names))
    labels = b"".join(name.ljust(width) for name in names)
    about = b"EgoCap, joints in the %s frame, z up" % markers.frame.encode()
    records = [
        _group("POINT"),
        _parameter("USED", _INTEGER, (), struct.pack("<h", len(names))),
        _parameter("FRAMES", _INTEGER, (), struct.pack("<h", len(markers.times))),
        _parameter("DATA_START", _INTEGER, (), struct.pack("<h", start)),
        _parameter("SCALE", _FLOAT, (), struct.pack("<f", -1.0)),
        _parameter("RATE", _FLOAT, (), struct.pack("<f", markers.fps)),
        _parameter("UNITS", _CHARACTER, (2,), b"mm"),
        _parameter("LABELS", _CHARACTER, (width, len(names)), labels),
        _parameter("DESCRIPTIONS", _CHARACTER, (len(about), 1), about),
        b"\0\0",
    ]
    size = 4 + sum(map(len, records))
    blocks = -(-size // _BLOCK)
    content = struct.pack("<BBBB", 1, 0x50, blocks, _INTEL) + b"".join(records)
    return content.ljust(blocks * _BLOCK, b"\0")


def _group(name: str) -> bytes:
    """A group with the number 1: length and -1, name, offset of the next record, no description."""
    return struct.pack("<bb", len(name), -1) + name.encode() + struct.pack("<hB", 3, 0)


def _parameter(name: str, kind: int, shape: Sequence[int], content: bytes) -> bytes:
    """A parameter of group 1 without description."""
    body = struct.pack("<bB", kind, len(shape)) + bytes(shape) + content + b"\0"
    offset = struct.pack("<h", 2 + len(body))
    return struct.pack("<bb", len(name), 1) + name.encode() + offset + body


def _data(markers: Markers) -> bytes:
    known = np.asarray(np.isfinite(markers.points).all(-1))
    rows = np.zeros((*known.shape, 4), "<f4")
    rows[..., :3] = np.where(known[..., None], 1000.0 * markers.points, 0.0)
    rows[..., 3] = np.where(known, 0.0, -1.0)
    content = rows.tobytes()
    return content.ljust(-(-len(content) // _BLOCK) * _BLOCK, b"\0")
