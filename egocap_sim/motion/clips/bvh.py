"""Read BVH files strictly, and pose their skeletons.

A BVH file is a tree of joints, each with an offset from its parent and some of the six channels
(Xposition ... Zrotation, in any order), and then one line of channel values a frame, in degrees and
in the length unit of the author. Rotations multiply in the order of the channels.
"""

from __future__ import annotations

import io
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.errors import FileError
from egocap.geometry import axis_angle
from egocap.schema import MOST_TEXT

_CHANNELS = tuple(f"{a}{kind}" for kind in ("position", "rotation") for a in "XYZ")
LARGEST = 1e7  # values beyond it are treated as damage
MOST_JOINTS, MOST_POSES = 1000, 1 << 22
"""Joints of a file, and joints times frames."""
LONGEST_LINE, MOST_LINES = 1 << 20, 1 << 22
"""Characters of a line, and lines of a file."""
_TOKEN = re.compile(r"[{}]|[^\s{}]+")


@dataclass(frozen=True, eq=False)
class Joint:
    """One joint of the hierarchy; `channels` are column numbers and names in the frame block."""

    name: str
    parent: int  # index into Bvh.joints, -1 for the root
    offset: tuple[float, float, float]  # from the parent, file units
    channels: tuple[tuple[int, str], ...]
    end_site: tuple[float, float, float] | None = None  # offset of the first end site, file units


@dataclass(frozen=True, eq=False)
class Bvh:
    """A parsed file: parents come before their children."""

    joints: tuple[Joint, ...]
    frame_time: float  # seconds
    frames: Float[Array, "T C"]  # degrees and file units

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(j.name for j in self.joints)

    @property
    def fps(self) -> float:
        return 1.0 / self.frame_time

    def local(self) -> tuple[Float[Array, "T J 3 3"], Float[Array, "T J 3"]]:
        """Rotation and translation of every joint in its parent's frame; file units."""
        T, J = len(self.frames), len(self.joints)
        R = np.broadcast_to(np.eye(3), (T, J, 3, 3)).copy()
        t = np.empty((T, J, 3))
        for j, joint in enumerate(self.joints):
            moved = np.zeros((T, 3))
            for column, channel in joint.channels:
                axis = "XYZ".index(channel[0])
                values = self.frames[:, column]
                if channel.endswith("rotation"):
                    R[:, j] = R[:, j] @ axis_angle(np.eye(3)[axis], np.radians(values))
                else:
                    moved[:, axis] = values
            t[:, j] = _translation(np.array(joint.offset), moved, joint.parent < 0)
        return R, t

    def rest_positions(self) -> Float[Array, "J 3"]:
        """World positions with every rotation zero and the root at its offset; file units."""
        p = np.zeros((len(self.joints), 3))
        for j, joint in enumerate(self.joints):
            p[j] = np.array(joint.offset) + (p[joint.parent] if joint.parent >= 0 else 0.0)
        return p


def _translation(
    offset: Float[Array, "3"], moved: Float[Array, "T 3"], root: bool
) -> Float[Array, "T 3"]:
    """Translation of a joint in its parent's frame.

    Tools disagree whether position channels replace the offset or add to it. For the root the
    choice only shifts the world; elsewhere values close to the offset replace it.
    """
    if root:
        return offset + moved
    replaces = np.linalg.norm(moved - offset, axis=1).mean() < np.linalg.norm(moved, axis=1).mean()
    return moved if replaces else offset + moved


def pose(
    parents: tuple[int, ...], R: Float[Array, "T J 3 3"], t: Float[Array, "T J 3"]
) -> tuple[Float[Array, "T J 3 3"], Float[Array, "T J 3"]]:
    """Forward kinematics: world rotations and positions from those in the parents' frames."""
    world, position = np.empty_like(R), np.empty_like(t)
    for j, p in enumerate(parents):
        if p < 0:
            world[:, j], position[:, j] = R[:, j], t[:, j]
        else:
            world[:, j] = world[:, p] @ R[:, j]
            position[:, j] = position[:, p] + np.einsum("tij,tj->ti", world[:, p], t[:, j])
    return world, position


def read_bvh(path: str | Path) -> Bvh:
    """Parse a BVH file.

    Raises FileError, with the line, for anything that is not a complete, finite, consistent file
    within the limits.
    """
    path = Path(path)
    try:
        if (size := path.stat().st_size) > MOST_TEXT:
            raise FileError(path, f"has {size:,} bytes", valid=f"at most {MOST_TEXT:,}")
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            return _parse(_Lines(file, path))
    except OSError as e:
        raise FileError(path, f"cannot be read: {e.strerror or e}") from e


def parse_bvh(text: str, path: str | Path = "<text>") -> Bvh:
    """Parse the text of a BVH file; `path` is for error messages only (see `read_bvh`)."""
    return _parse(_Lines(io.StringIO(text, newline=None), path))


class _Lines:
    """The lines of a file, one by one; `number` is the 1-based number of the line last read."""

    def __init__(self, file: TextIO, path: str | Path) -> None:
        self._file, self._path, self.number = file, path, 0

    def __iter__(self) -> _Lines:
        return self

    def __next__(self) -> str:
        line = self._file.readline(LONGEST_LINE + 1)
        if not line:
            raise StopIteration
        self.number += 1
        if len(line) > LONGEST_LINE:
            raise self.fail("a longer line", valid=f"at most {LONGEST_LINE:,} characters")
        if self.number > MOST_LINES:
            raise self.fail("more lines", valid=f"at most {MOST_LINES:,}")
        return line

    def fail(self, problem: str, valid: str | None = None) -> FileError:
        """An error at the line last read."""
        return FileError(self._path, problem, line=max(self.number, 1), valid=valid)


def _parse(lines: _Lines) -> Bvh:
    joints, columns = _Hierarchy(lines).read()
    frame_time, count = _motion_header(lines)
    if count * len(joints) > MOST_POSES:
        raise lines.fail(f"{count:,} frames of {len(joints)} joints",
                         valid=f"at most {MOST_POSES // len(joints):,} frames")  # fmt: skip
    return Bvh(joints, frame_time, _frame_block(lines, count, columns))


class _Hierarchy:
    """Reads tokens up to MOTION."""

    def __init__(self, lines: _Lines) -> None:
        self.fail = lines.fail
        self._tokens = (token for line in lines for token in _TOKEN.findall(line))
        self._names: set[str] = set()

    def next(self, expecting: str) -> str:
        for token in self._tokens:
            return token
        raise self.fail(f"the file ends where {expecting} is expected")

    def expect(self, word: str) -> None:
        token = self.next(f"'{word}'")
        if token.upper() != word:
            raise self.fail(f"'{token[:40]}' where '{word}' is expected")

    def number(self, what: str) -> float:
        token = self.next(what)
        value = _float(token)
        if not abs(value) < LARGEST:
            raise self.fail(f"'{token[:40]}' is not a finite number of plausible size ({what})")
        return value

    def name(self) -> str:
        words = []
        while (token := self.next("'{'")) != "{":
            if token == "}":
                raise self.fail("'}' where '{' is expected")
            words.append(token)
        if not words:
            raise self.fail("a joint without a name")
        return " ".join(words)

    def offset(self) -> tuple[float, float, float]:
        self.expect("OFFSET")
        return self.number("an offset"), self.number("an offset"), self.number("an offset")

    def channels(self, column: int) -> tuple[tuple[int, str], ...]:
        count = self.number("a channel count")
        if count not in range(7):
            raise self.fail(f"{count:g} channels", valid="0 to 6")
        found: list[str] = []
        for _ in range(int(count)):
            token = self.next("a channel name")
            name = token[:1].upper() + token[1:].lower()
            if name not in _CHANNELS:
                raise self.fail(f"unknown channel '{token[:40]}'", valid=", ".join(_CHANNELS))
            if name in found:
                raise self.fail(f"channel '{name}' twice in one joint")
            found.append(name)
        return tuple((column + i, name) for i, name in enumerate(found))

    def read(self) -> tuple[tuple[Joint, ...], int]:
        """All joints, and the number of channels."""
        self.expect("HIERARCHY")
        if (token := self.next("'ROOT'").upper()) != "ROOT":
            raise self.fail(f"no joints: '{token[:40]}' where 'ROOT' is expected")
        joints: list[dict] = []
        column = self._joint(joints, -1, 0)
        stack = [0]
        while stack:
            token = self.next("'}'").upper()
            if token == "}":
                stack.pop()
            elif token == "JOINT":
                column = self._joint(joints, stack[-1], column)
                stack.append(len(joints) - 1)
            elif token == "END":
                self.name()
                end = self.offset()
                self.expect("}")
                joints[stack[-1]].setdefault("end_site", end)
            else:
                raise self.fail(f"'{token[:40]}'", valid="JOINT, End Site, }")
        token = self.next("'MOTION'").upper()
        if token != "MOTION":
            raise self.fail(f"'{token[:40]}' where 'MOTION' is expected (one skeleton a file)")
        if column == 0:
            raise self.fail("no joint has a channel")
        return tuple(Joint(**j) for j in joints), column

    def _joint(self, joints: list[dict], parent: int, column: int) -> int:
        name = self.name()
        if name in self._names:
            raise self.fail(f"two joints are called '{name}'")
        if len(joints) == MOST_JOINTS:
            raise self.fail("more joints", valid=f"at most {MOST_JOINTS:,}")
        self._names.add(name)
        offset = self.offset()
        joint = {"name": name, "parent": parent, "offset": offset, "channels": ()}
        self.expect("CHANNELS")
        joint["channels"] = self.channels(column)
        joints.append(joint)
        return column + len(joint["channels"])


def _motion_header(lines: _Lines) -> tuple[float, int]:
    """Frame time and frame count."""
    found: list[float] = []
    for line in lines:
        if not line.strip():
            continue
        key, _, value = line.partition(":")
        wanted = ("frames", "frame time")[len(found)]
        if " ".join(key.lower().split()) != wanted:
            raise lines.fail(f"no '{wanted.title()}:' after MOTION")
        found.append(_float(value))
        low, high = (1.0, LARGEST) if wanted == "frames" else (1e-5, 1.0)
        if not low <= found[-1] <= high:
            raise lines.fail(f"{wanted.title()} is '{value.strip()[:40]}'",
                             valid=f"above 0, {low:g} to {high:g}")  # fmt: skip
        if found[0] != int(found[0]):
            raise lines.fail(f"{found[0]:g} frames", valid="a whole number")
        if len(found) == 2:
            return found[1], int(found[0])
    raise lines.fail("ends before 'Frames:' and 'Frame Time:' of MOTION")


def _frame_block(lines: _Lines, count: int, columns: int) -> Float[Array, "T C"]:
    """The channel values; a frame may span several lines."""
    values, filled = np.empty(count * columns), 0
    for line in lines:
        words = line.split()
        end = filled + len(words)
        if end > values.size:
            raise lines.fail(f"more values than {count} frames of {columns} channels",
                             valid=f"{values.size} values")  # fmt: skip
        try:
            values[filled:end] = words
        except ValueError:
            values[filled:end] = np.nan
        if not (np.abs(values[filled:end]) < LARGEST).all():
            wrong = next(word for word in words if not abs(_float(word)) < LARGEST)
            raise lines.fail(f"'{wrong[:40]}' is not a finite number of plausible size")
        filled = end
    if filled < values.size:
        raise lines.fail(f"{filled} values for {count} frames of {columns} channels"
                         f" ({filled / columns:.6g} frames)", f"{values.size} values")  # fmt: skip
    return values.reshape(count, columns)


def _float(word: str) -> float:
    """The number, or NaN for anything else."""
    try:
        return float(word)
    except ValueError:
        return math.nan
