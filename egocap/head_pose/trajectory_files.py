"""Trajectories of other programs: TUM, EuRoC, COLMAP, Aria MPS, ARKit and OpenXR.

In: a text file. Out: times, poses of the device, and what the format says of its axes. Sources:
cvg.cit.tum.de (RGB-D benchmark), projects.asl.ethz.ch (EuRoC MAV), colmap.github.io/format.html,
facebookresearch.github.io/projectaria_tools (MPS), ARKit and OpenXR: y up, the device looks at -z.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.errors import FileError, InputError
from egocap.geometry import inverse, quaternion_to_matrix, rigid
from egocap.schema import read_text

FORMATS = ("tum", "euroc", "colmap", "aria", "arkit", "openxr")
R_DEVICE_HEAD_XR = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
"""Head axes (forward, left, up) in a device whose x is right, y up and z backwards."""
_COLMAP_LINE = "IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME"
_PLACES = ("t", "p", "position_", "pos_", "")
_TURNS = ("q", "q_", "rotation_", "orientation_", "rot_")
_Z, _Y = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
_SECONDS = {"_ns": 1e-9, "_us": 1e-6, "_ms": 1e-3, "_s": 1.0}


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses of a device (or camera) in a world of its program's choice."""

    form: str  # of FORMATS
    time: Float[Array, "N"]  # s, increasing; of COLMAP: frame numbers
    T_world_device: Float[Array, "N 4 4"]  # metres; of COLMAP: its own unit
    up: Float[Array, "3"] | None  # unit vector in that world, where the format knows it
    R_device_head: Float[Array, "3 3"] | None  # where the format fixes the device's axes
    view: tuple[str, ...] = ()  # of COLMAP: each picture's folder or suffix


def read_trajectory(path: str | Path, form: str | None = None) -> Trajectory:
    """Read a trajectory; the format is recognised when None. FileError names the line."""
    if form is not None and form not in _READERS:
        raise InputError(f"no format '{form}' of trajectories", valid=_READERS)
    text = read_text(path)
    form = form or _recognised(path, text)
    found = _READERS[form](Path(path), text)
    if len(found.time) < 2:
        raise FileError(path, f"holds {len(found.time)} poses", valid="two or more")
    order = np.argsort(found.time, kind="stable")
    time, view = found.time[order], tuple(found.view[i] for i in order) if found.view else ()
    if form != "colmap" and (np.diff(time) <= 0).any():
        raise FileError(path, f"the time {time[:-1][np.diff(time) <= 0][0]:.9g} s occurs twice",
                        valid="one pose an instant")  # fmt: skip
    return replace(found, time=time, T_world_device=found.T_world_device[order], view=view)


def _recognised(path: str | Path, text: str) -> str:
    head = text[:4000].lower()
    first = next((line for _, line in _rows(text)), "")
    if "tracking_timestamp_us" in head:
        return "aria"
    if "p_rs_r_x" in head or "q_rs_w" in head or re.match(r"^\d{16,}\s*,", first):
        return "euroc"
    if "image_id, qw, qx" in head or len(first.split()) == 10:
        return "colmap"
    if len(first.split()) == 8 and "," not in first:
        return "tum"
    if "," in first and re.search(r"\bq_?x\b|rotation_?x|orientation", head):
        return "openxr" if "openxr" in head or "xr_time" in head else "arkit"
    raise FileError(path, "not a known trajectory", valid=FORMATS)


def _tum(path: Path, text: str) -> Trajectory:
    rows = [table_row(path, n, line.split(), 8) for n, line in _rows(text)]
    table = np.array(rows).reshape(-1, 8)
    T = _poses(path, table[:, [7, 4, 5, 6]], table[:, 1:4])
    return Trajectory("tum", table[:, 0], T, _Z, None)


def _euroc(path: Path, text: str) -> Trajectory:
    rows = [table_row(path, n, line.split(","), 8) for n, line in _rows(text)
            if not line[:1].isalpha()]  # fmt: skip
    table = np.array(rows).reshape(-1, 8)
    # Differences in whole nanoseconds are exact in float64 up to 2^53.
    return Trajectory("euroc", table[:, 0] * 1e-9, _poses(path, table[:, 4:8], table[:, 1:4]), _Z,
                      None)  # fmt: skip


def _colmap(path: Path, text: str) -> Trajectory:
    """images.txt: each picture's line is followed by that of its points, which may be empty."""
    lines = [(n, line) for n, line in enumerate(text.splitlines(), 1) if not line.startswith("#")]
    for n, line in lines[1::2]:
        if len(line.split()) % 3:
            raise FileError(path, "a picture's points are not X, Y, POINT3D_ID", line=n,
                            valid="two lines a picture, the second may be empty")  # fmt: skip
    numbers, views, rows = [], [], []
    for n, line in lines[::2]:
        words = line.split(None, 9)
        if not words:
            continue
        if len(words) != 10:
            raise FileError(path, f"{len(words)} columns", line=n, valid=_COLMAP_LINE)
        digits = re.findall(r"\d+", Path(words[9]).stem)
        if not digits:
            raise FileError(path, f"no frame number in the name '{words[9]}'", line=n)
        numbers.append(float(digits[-1]))
        views.append(_view(words[9]))
        rows.append(table_row(path, n, words[1:8], 7))
    table = np.array(rows).reshape(-1, 7)
    T_camera_world = _poses(path, table[:, :4], table[:, 4:7])
    return Trajectory("colmap", np.array(numbers), inverse(T_camera_world), None, None,
                      tuple(views))  # fmt: skip


def _view(name: str) -> str:
    """'left' of left/000012.png, 000012.left.png and left_000012.png."""
    path = Path(name)
    if len(path.parts) > 1:
        return path.parts[-2]
    return re.sub(r"\d+", "", path.stem).strip("._- ")


def _aria(path: Path, text: str) -> Trajectory:
    place = [f"t{a}_world_device" for a in "xyz"] + [f"q{a}_world_device" for a in "wxyz"]
    table, _ = _by_name(path, text, ("tracking_timestamp_us", *place))
    up, known = _by_name(path, text, tuple(f"gravity_{a}_world" for a in "xyz"), optional=True)
    direction = -np.median(up, axis=0) if known and len(up) else _Z
    size = float(np.linalg.norm(direction))
    if not size > 0.0:
        raise FileError(path, "0", key="gravity_x_world to gravity_z_world", valid="a direction")
    T = _poses(path, table[:, 4:8], table[:, 1:4])
    return Trajectory("aria", table[:, 0] * 1e-6, T, direction / size, None)


def _xr(form: str) -> Callable[[Path, str], Trajectory]:
    def read(path: Path, text: str) -> Trajectory:
        header = [w.strip().lower() for w in next(_rows(text), (0, ""))[1].split(",")]
        time = next((w for w in header if w.startswith(("timestamp", "time", "xr_time"))), "time")
        unit = next((s for end, s in _SECONDS.items() if time.endswith(end)), 1.0)
        columns = [_first(header, [f"{name}{a}" for name in _PLACES]) for a in "xyz"]
        columns += [_first(header, [f"{name}{a}" for name in _TURNS]) for a in "wxyz"]
        table, _ = _by_name(path, text, (time, *columns))
        T = _poses(path, table[:, 4:8], table[:, 1:4])
        return Trajectory(form, table[:, 0] * unit, T, _Y, R_DEVICE_HEAD_XR)

    return read


def _first(header: list[str], names: Iterable[str]) -> str:
    names = tuple(names)
    return next((name for name in names if name in header), names[0])


def _by_name(
    path: Path, text: str, columns: tuple[str, ...], optional: bool = False
) -> tuple[Float[Array, "N C"], bool]:
    """Columns of a CSV with a header, and whether they are there. FileError unless optional."""
    rows = iter(_rows(text))
    number, first = next(rows, (1, ""))
    header = [w.strip().lower() for w in first.lstrip("#").split(",")]
    missing = [c for c in columns if c not in header]
    if missing and optional:
        return np.zeros((0, len(columns))), False
    if missing:
        raise FileError(path, f"no column {', '.join(missing)}", line=number, valid=header)
    places = [header.index(c) for c in columns]
    table = []
    for n, line in rows:
        words = line.split(",")
        if len(words) < len(header):
            raise FileError(path, f"{len(words)} columns", line=n, valid=str(len(header)))
        table.append(table_row(path, n, [words[i] for i in places], len(places)))
    return np.array(table).reshape(-1, len(columns)), True


def _rows(text: str) -> Iterator[tuple[int, str]]:
    """Numbered lines that are neither empty nor comments."""
    lines = ((n, line.strip()) for n, line in enumerate(text.splitlines(), 1))
    return ((n, line) for n, line in lines if line and not line.startswith("#"))


def table_row(path: Path, line: int, words: list[str], count: int) -> list[float]:
    if len(words) < count:
        raise FileError(path, f"{len(words)} numbers", line=line, valid=str(count))
    try:
        values = [float(word) for word in words[:count]]
    except ValueError:
        raise FileError(path, "not a number", line=line) from None
    if not np.isfinite(values).all():
        raise FileError(path, "not a finite number", line=line)
    return values


def _poses(
    path: Path, quaternions: Float[Array, "N 4"], translations: Float[Array, "N 3"]
) -> Float[Array, "N 4 4"]:
    """T from w, x, y, z and translations. Raises FileError for what is no unit quaternion."""
    length = np.linalg.norm(quaternions, axis=1)
    if (np.abs(length - 1.0) > 1e-2).any():
        worst = int(np.abs(length - 1.0).argmax())
        raise FileError(
            path, f"pose {worst}: a quaternion of length {length[worst]:.3g}", valid="1"
        )
    return rigid(quaternion_to_matrix(quaternions), translations)


_READERS: dict[str, Callable[[Path, str], Trajectory]] = {
    "tum": _tum, "euroc": _euroc, "colmap": _colmap, "aria": _aria, "arkit": _xr("arkit"),
    "openxr": _xr("openxr"),
}  # fmt: skip
