"""Measurements of an inertial sensor: a CSV of times, angular rates and specific forces.

The header names the columns. Recognised: `timestamp_s,gx,gy,gz,ax,ay,az` and its usual variants
(time; gyro_x, wx; acc_x, accel_x), times in s, ms, us or ns by the name's ending, and EuRoC's
`#timestamp [ns],w_RS_S_x [rad s^-1],...,a_RS_S_x [m s^-2],...` (projects.asl.ethz.ch, EuRoC MAV).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.errors import FileError
from egocap.geometry import GRAVITY
from egocap.head_pose.trajectory_files import table_row
from egocap.schema import read_text

_G = float(np.linalg.norm(GRAVITY))
_GYRO = ("g{}", "gyro_{}", "gyr_{}", "w{}", "omega_{}", "w_rs_s_{}", "angular_velocity_{}")
_FORCE = ("a{}", "acc_{}", "accel_{}", "accelerometer_{}", "a_rs_s_{}", "linear_acceleration_{}")
_SECONDS = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0}
_TIME = re.compile(r"(?:time|timestamp|t)(?:_(ns|us|ms|s))?$")
_EXAMPLE = "timestamp_s,gx,gy,gz,ax,ay,az"
_FEWEST = 100


@dataclass(frozen=True, eq=False)
class Imu:
    """Measurements in the sensor's own axes and clock."""

    time: Float[Array, "N"]  # s, increasing
    rate: Float[Array, "N 3"]  # rad/s
    force: Float[Array, "N 3"]  # m/s^2; a sensor at rest measures 9.81 upwards


def read_imu(path: str | Path) -> Imu:
    """Read a sensor's file. Raises FileError for missing columns, units, and times that fall."""
    path = Path(path)
    lines = [(n, line.strip()) for n, line in enumerate(read_text(path).splitlines(), 1)]
    first, *rows = [(n, line) for n, line in lines if line] or [(1, "")]
    header = [_bare(word) for word in first[1].lstrip("#").split(",")]
    time = next((name for name in header if _TIME.match(name)), None)
    wanted = [
        name for forms in (_GYRO, _FORCE) for a in "xyz" if (name := _named(header, forms, a))
    ]
    if time is None or len(wanted) < 6:
        raise FileError(path, f"has the columns {', '.join(header)[:120]}", valid=_EXAMPLE)
    if len(rows) < _FEWEST:
        raise FileError(path, f"holds {len(rows)} measurements", valid=f"{_FEWEST} or more")
    table = np.array([table_row(path, n, line.split(","), len(header)) for n, line in rows])
    table = table[:, [header.index(name) for name in (time, *wanted)]]
    unit = _SECONDS[_TIME.match(time)[1] or "s"]  # type: ignore[index]
    found = Imu(table[:, 0] * unit, table[:, 1:4], table[:, 4:])
    _check(path, found)
    return found


def _bare(word: str) -> str:
    """'timestamp_ns' of ' Timestamp [ns]', 'w_rs_s_x' of 'w_RS_S_x [rad s^-1]'."""
    word = word.strip().lower()
    name, _, unit = word.partition(" [")
    unit = unit.rstrip("]")
    return f"{name}_{unit}" if unit in _SECONDS else name


def _named(header: list[str], forms: tuple[str, ...], axis: str) -> str | None:
    names = [form.format(axis) for form in forms]
    return next((name for name in names if name in header), None)


def _check(path: Path, found: Imu) -> None:
    step = np.diff(found.time)
    if not (step > 0).all():
        row = int(np.flatnonzero(~(step > 0))[0]) + 1
        raise FileError(path, f"measurement {row}: its time is not after the one before")
    size = float(np.median(np.linalg.norm(found.force, axis=1)))
    if not 0.8 * _G < size < 1.2 * _G:
        unit = ", as if in g" if 0.8 < size < 1.2 else ""
        raise FileError(path, f"the specific force is {size:.3g} in the median{unit}",
                        valid=f"about {_G:.2f} m/s^2")  # fmt: skip
    fastest = float(np.median(np.linalg.norm(found.rate, axis=1)))
    if fastest > 10.0:
        raise FileError(path, f"the angular rate is {fastest:.3g} in the median",
                        valid="rad/s, not degrees")  # fmt: skip
