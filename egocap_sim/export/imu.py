"""Export of what an inertial sensor on the head would measure, as CSV, and its errors as JSON.

The true head poses are interpolated by splines, twice differentiable, and sampled at `RATE`. Axes
are the head's: x forward, y left, z up. Columns: `timestamp_s,gx,gy,gz,ax,ay,az`, in rad/s and
m/s^2; the accelerometer of a head at rest measures +9.81 along z. White noise and a constant bias
are drawn from the sequence's seed.

Source: noise densities of the ADIS16448, as given with the EuRoC data set, Burri et al. 2016.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.data.sequence import Sequence
from egocap.errors import InputError
from egocap.files import write_atomically, write_json
from egocap.geometry import GRAVITY
from egocap_sim.core.rng import make_rng
from egocap_sim.export.formats import new_file

RATE = 200.0  # Hz
GYRO_NOISE, ACCELERATION_NOISE = 1.7e-4, 2.0e-3  # rad/s/sqrt(Hz), m/s^2/sqrt(Hz)
GYRO_BIAS, ACCELERATION_BIAS = 0.005, 0.05  # standard deviations, rad/s, m/s^2
HEADER = "timestamp_s,gx,gy,gz,ax,ay,az"
_FEWEST = 4  # frames


def write_imu(sequence: Sequence, out: Path, on_frames: Callable[[int], None]) -> None:
    """Write the measurements (.csv), and rate, noise and biases beside them (.json).

    Raises InputError for another ending, and for fewer than four frames.
    """
    new_file(out, ".csv")
    truth = sequence.truth
    if len(truth.time) < _FEWEST:
        raise InputError(f"{len(truth.time)} frames", valid=f"{_FEWEST} or more for an IMU")
    times, gyro, acceleration = ideal_imu(truth.time, truth.T_world_head, RATE)
    rng = make_rng(sequence.manifest.seed, "imu")
    bias = np.concatenate([rng.normal(0, GYRO_BIAS, 3), rng.normal(0, ACCELERATION_BIAS, 3)])
    noise = np.repeat([GYRO_NOISE, ACCELERATION_NOISE], 3) * np.sqrt(RATE)
    clean = np.concatenate([gyro, acceleration], 1)
    measured = clean + bias + noise * rng.normal(size=(len(times), 6))
    rows = [",".join([f"{t:.6f}", *(f"{v:.8f}" for v in row)])
            for t, row in zip(times, measured, strict=True)]  # fmt: skip
    write_atomically(out, "\n".join([HEADER, *rows]) + "\n")
    write_json(out.with_suffix(".json"), {
        "frame": "head", "rate_hz": RATE, "gyro_noise_density": GYRO_NOISE,
        "accelerometer_noise_density": ACCELERATION_NOISE, "gyro_bias": bias[:3].tolist(),
        "accelerometer_bias": bias[3:].tolist(),
        "units": "rad/s, m/s^2; densities per sqrt(Hz)",
    })  # fmt: skip
    on_frames(len(sequence))


def ideal_imu(
    times: Float[Array, "T"], T_world_head: Float[Array, "T 4 4"], rate: float
) -> tuple[Float[Array, "N"], Float[Array, "N 3"], Float[Array, "N 3"]]:
    """Times, angular velocity [rad/s] and specific force [m/s^2] in the head frame."""
    from scipy.interpolate import make_interp_spline
    from scipy.spatial.transform import Rotation, RotationSpline

    at = times[0] + np.arange(int((times[-1] - times[0]) * rate + 1e-6) + 1) / rate
    turning = RotationSpline(times, Rotation.from_matrix(T_world_head[:, :3, :3]))
    way = make_interp_spline(times, T_world_head[:, :3, 3], k=3)
    force = way(at, 2) - GRAVITY
    return at, turning(at, 1), turning(at).inv().apply(force)
