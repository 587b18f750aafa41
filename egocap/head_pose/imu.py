"""Up from an inertial sensor on the head: gravity is what its forces hold beside the motion.

The sensor's clock and axes come from the angular rates of both. Then, over windows of the
recording, the measured specific force is that of gravity, of the head's acceleration (second
differences of its positions), of the sensor's place on the head, and of its bias; all that is
unknown in it enters linearly. A second difference over 2 h is the acceleration under a triangle of
that width, so the measurements are averaged under the same triangle and nothing is differentiated
that is not measured.

Source: initialisation of VINS-Mono, Qin et al. 2018, V-B, with known scale and by windows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from egocap.errors import InputError
from egocap.footage.signals import ViewSignal
from egocap.geometry import GRAVITY, skew
from egocap.head_pose.alignment import angular_rates, rate_alignment
from egocap.head_pose.imu_files import Imu
from egocap.head_pose.vertical import Vertical
from egocap.series import interpolate

HALF_WINDOW = 0.5  # s
FEWEST_WINDOWS = 8
BIAS_STD, PLACE_STD, AXES_STD = 0.3, 0.15, np.deg2rad(2.0)  # m/s^2, m, rad
MOST_OFF = 0.5  # m/s^2, of gravity's size
_G = float(np.linalg.norm(GRAVITY))
_INDEPENDENT = 4.0  # windows whose errors are alike
_ROUNDS = 8


@dataclass(frozen=True, eq=False)
class Inertial:
    """What a sensor says of the map that the head moves in."""

    vertical: Vertical
    offset_s: float  # time of the poses less time of the sensor
    offset_std_s: float
    R_sensor_head: Float[Array, "3 3"]
    place: Float[Array, "3"]  # of the sensor, head frame, m
    residual: float  # m/s^2, of a window

    def facts(self) -> dict[str, Any]:
        """JSON-ready form."""
        return {
            "offset_s": round(self.offset_s, 5),
            "offset_std_ms": round(1e3 * self.offset_std_s, 3),
            "place_m": np.round(self.place, 4).tolist(),
            "residual_m_s2": round(self.residual, 4),
        }


class _Windows(NamedTuple):
    """Means under triangles; the model is force - motion = gravity + bias, place and axes."""

    force: Float[Array, "n 3"]  # specific force less the head's acceleration, map frame
    bias: Float[Array, "n 3 3"]
    place: Float[Array, "n 3 3"]
    axes: Float[Array, "n 3 3"]


def vertical_by_imu(
    time: Float[Array, "N"], T_map_head: Float[Array, "N 4 4"], imu: Imu
) -> Inertial:
    """Up in the map, and the sensor's clock, axes and place.

    Raises InputError where the head hardly turns, or nothing fits gravity.
    """
    offset, offset_std, R = _clock(time, T_map_head, imu)
    for _ in range(2):  # the axes enter linearly about the last
        windows = _windows(time, T_map_head, imu, offset, R)
        x, covariance, residual = _solved(windows)
        R = Rotation.from_rotvec(x[9:]).as_matrix().T @ R
    size = float(np.linalg.norm(x[:3]))
    if abs(size - _G) > MOST_OFF:
        raise InputError(f"the sensor's forces less the head's motion leave {size:.2f} m/s^2",
                         valid=f"gravity, {_G:.2f}: the same motion, in m/s^2")  # fmt: skip
    up = x[:3] / size
    across = np.eye(3) - np.outer(up, up)
    std = float(np.sqrt(np.trace(across @ covariance[:3, :3] @ across))) / size
    return Inertial(Vertical(up, std, "IMU"), offset, offset_std, R, x[6:9], residual)


def _clock(
    time: Float[Array, "N"], T: Float[Array, "N 4 4"], imu: Imu
) -> tuple[float, float, Float[Array, "3 3"]]:
    """Offset, its standard deviation, and the sensor's axes R_sensor_head, free of a gyro bias."""
    head = angular_rates(time, T[:, :3, :3])
    sensor = _averaged(imu, float(np.median(np.diff(time))))
    for _ in range(2):
        offset, std, _, R = rate_alignment(head, sensor, names=("head's motion", "IMU"))
        at = sensor.time + offset
        inside = (at >= head.time[0]) & (at <= head.time[-1])
        bias = np.median(
            sensor.rate[inside] - interpolate(at[inside], head.time, head.rate) @ R.T, 0
        )
        sensor = ViewSignal(sensor.time, sensor.rate - bias)
    return offset, std, R


def _averaged(imu: Imu, period: float) -> ViewSignal:
    """Angular rates averaged over about a period of the pictures."""
    count = max(1, round(period / float(np.median(np.diff(imu.time)))))
    rows = len(imu.time) // count * count
    return ViewSignal(imu.time[:rows].reshape(-1, count).mean(1),
                      imu.rate[:rows].reshape(-1, count, 3).mean(1))  # fmt: skip


def _windows(
    time: Float[Array, "N"], T: Float[Array, "N 4 4"], imu: Imu, offset: float,
    R_sensor_head: Float[Array, "3 3"],
) -> _Windows:  # fmt: skip
    """Windows half a second apart in which poses and measurements have no gap."""
    at = imu.time + offset
    way, turn = CubicSpline(time, T[:, :3, 3]), Slerp(time, Rotation.from_matrix(T[:, :3, :3]))
    found: list[tuple[Array, ...]] = []
    for centre, rows in _whole(time, at):
        weight = 1.0 - np.abs(at[rows] - centre) / HALF_WINDOW
        weight /= weight.sum()
        R = turn(at[rows]).as_matrix() @ R_sensor_head.T
        ends = np.array([centre - HALF_WINDOW, centre, centre + HALF_WINDOW])
        difference = np.array([1.0, -2.0, 1.0]) / HALF_WINDOW**2
        force = np.einsum("i,ijk,ik->j", weight, R, imu.force[rows])
        found.append((
            force - difference @ way(ends),
            np.einsum("i,ijk->jk", weight, R),
            np.einsum("i,ijk->jk", difference, turn(ends).as_matrix()),
            np.einsum("i,ijk,ikl->jl", weight, R, skew(imu.force[rows])),
        ))  # fmt: skip
    if len(found) < FEWEST_WINDOWS:
        raise InputError(f"head poses and IMU have {len(found)} half seconds in common",
                         valid=f"{FEWEST_WINDOWS} or more without a gap")  # fmt: skip
    return _Windows(*(np.stack(column) for column in zip(*found, strict=True)))


def _whole(time: Float[Array, "N"], at: Float[Array, "M"]) -> Iterator[tuple[float, slice]]:
    """Centres of windows without gaps, and the measurements inside."""
    longest = [3.5 * float(np.median(np.diff(t))) for t in (time, at)]
    first, last = max(time[0], at[0]) + HALF_WINDOW, min(time[-1], at[-1]) - HALF_WINDOW
    for centre in np.arange(first, last, HALF_WINDOW):
        low, high = centre - HALF_WINDOW, centre + HALF_WINDOW
        rows = [slice(*np.searchsorted(t, [low, high])) for t in (time, at)]
        steps = [np.diff(np.concatenate([[low], t[r], [high]])).max(initial=0.0)
                 for t, r in zip((time, at), rows, strict=True)]  # fmt: skip
        if all(step <= most for step, most in zip(steps, longest, strict=True)):
            yield float(centre), rows[1]


def _solved(windows: _Windows) -> tuple[Float[Array, "12"], Float[Array, "12 12"], float]:
    """Gravity's reaction, bias, place and turn of the axes; covariance; residual of a window."""
    n = len(windows.force)
    A = np.concatenate([np.tile(np.eye(3), (n, 1, 1)), windows.bias, windows.place,
                        windows.axes], 2)  # fmt: skip
    prior = np.repeat([0.0, BIAS_STD**-2, PLACE_STD**-2, AXES_STD**-2], 3)
    weight, sigma = np.ones(n), 0.1
    for _ in range(_ROUNDS):
        H = np.einsum("n,nij,nik->jk", weight / sigma**2, A, A) + np.diag(prior)
        x = np.linalg.solve(H, np.einsum("n,nij,ni->j", weight / sigma**2, A, windows.force))
        error = np.linalg.norm(windows.force - A @ x, axis=1)
        sigma = max(float(np.median(error)) / 1.538, 1e-3)  # of a component of three
        weight = 1.0 / (1.0 + (error / (3.0 * sigma)) ** 2) ** 2
    return x, _INDEPENDENT * np.linalg.inv(H), sigma
