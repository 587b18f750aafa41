"""Read BVH files strictly, and pose their skeletons.

A BVH file is a tree of joints, each with an offset from its parent and some of the six channels
(Xposition ... Zrotation, in any order), and then one line of channel values a frame, in degrees and
in the length unit of the author. Rotations multiply in the order of the channels.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.errors import FileError
from egocap.geometry import axis_angle

_CHANNELS = tuple(f"{a}{kind}" for kind in ("position", "rotation") for a in "XYZ")
LARGEST = 1e7  # values beyond it are treated as damage
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

    Raises FileError, with the line, for anything that is not a complete, finite, consistent file.
    """
    path = Path(path)
    try:
        text = path.read_bytes().decode("utf-8-sig", errors="replace")
    except OSError as e:
        raise FileError(path, f"cannot be read: {e.strerror or e}") from e
    return parse_bvh(text, path)


def parse_bvh(text: str, path: str | Path = "<text>") -> Bvh:
    """Parse the text of a BVH file; `path` is for error messages only (see `read_bvh`)."""
    lines = text.splitlines()
    reader = _Hierarchy(lines, path)
    joints, columns = reader.read()
    frame_time, count, start = _motion_header(lines, reader.line, path)
    return Bvh(joints, frame_time, _frame_block(lines, start, count, columns, path))


class _Hierarchy:
    """Reads tokens up to MOTION; `line` is the 1-based number of the line last read."""

    def __init__(self, lines: list[str], path: str | Path) -> None:
        self.path, self.line = path, 0
        self._tokens = ((n, m) for n, s in enumerate(lines, 1) for m in _TOKEN.findall(s))

    def fail(self, problem: str, valid: str | None = None) -> FileError:
        return FileError(self.path, problem, line=max(self.line, 1), valid=valid)

    def next(self, expecting: str) -> str:
        try:
            self.line, token = next(self._tokens)
        except StopIteration:
            raise self.fail(f"the file ends where {expecting} is expected") from None
        return token

    def expect(self, word: str) -> None:
        token = self.next(f"'{word}'")
        if token.upper() != word:
            raise self.fail(f"'{token[:40]}' where '{word}' is expected")

    def number(self, what: str) -> float:
        token = self.next(what)
        try:
            value = float(token)
        except ValueError:
            value = math.nan
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
        if any(j["name"] == name for j in joints):
            raise self.fail(f"two joints are called '{name}'")
        offset = self.offset()
        joint = {"name": name, "parent": parent, "offset": offset, "channels": ()}
        self.expect("CHANNELS")
        joint["channels"] = self.channels(column)
        joints.append(joint)
        return column + len(joint["channels"])


def _motion_header(lines: list[str], line: int, path: str | Path) -> tuple[float, int, int]:
    """Frame time, frame count, and the index of the first line after them."""
    found: list[float] = []
    for n in range(line, len(lines)):
        if not lines[n].strip():
            continue
        key, _, value = lines[n].partition(":")
        wanted = ("frames", "frame time")[len(found)]
        if " ".join(key.lower().split()) != wanted:
            raise FileError(path, f"no '{wanted.title()}:' after MOTION", line=n + 1)
        try:
            found.append(float(value))
        except ValueError:
            found.append(math.nan)
        low, high = (1.0, LARGEST) if wanted == "frames" else (1e-5, 1.0)
        if not low <= found[-1] <= high:
            raise FileError(
                path,
                f"{wanted.title()} is '{value.strip()[:40]}'",
                line=n + 1,
                valid=f"above 0, {low:g} to {high:g}",
            )
        if len(found) == 2:
            if found[0] != int(found[0]):
                raise FileError(path, f"{found[0]:g} frames", line=n, valid="a whole number")
            return found[1], int(found[0]), n + 1
    raise FileError(
        path, "ends before 'Frames:' and 'Frame Time:' of MOTION", line=max(len(lines), 1)
    )


def _frame_block(
    lines: list[str], start: int, count: int, columns: int, path: str | Path
) -> Float[Array, "T C"]:
    """The channel values; a frame may span several lines."""
    try:
        values = np.array(" ".join(lines[start:]).split(), dtype=np.float64)
    except ValueError:
        values = None
    if values is None or not (np.abs(values) < LARGEST).all():
        raise _bad_number(lines, start, path)
    if values.size != count * columns:
        raise FileError(
            path,
            f"{values.size} values for {count} frames of {columns} channels"
            f" ({values.size / columns:.6g} frames)",
            line=len(lines),
            valid=f"{count * columns} values",
        )
    return values.reshape(count, columns)


def _bad_number(lines: list[str], start: int, path: str | Path) -> FileError:
    for n in range(start, len(lines)):
        for word in lines[n].split():
            try:
                good = abs(float(word)) < LARGEST
            except ValueError:
                good = False
            if not good:
                return FileError(
                    path, f"'{word[:40]}' is not a finite number of plausible size", line=n + 1
                )
    return FileError(path, "a frame value is not a finite number", line=start + 1)
