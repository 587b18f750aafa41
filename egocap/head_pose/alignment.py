"""A trajectory of another device against head poses of the same motion: clock, axes, place.

The clock comes from the angular rates of both, the device's axes on the head from the directions of
these rates, its place on the head from how it moves while the head turns.
Source: hand-eye calibration, Tsai and Lenz 1989; rates, as in `egocap.footage.synchronisation`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.spatial.transform import Rotation, Slerp

from egocap.errors import InputError
from egocap.footage.synchronisation import ViewSignal, coarse_lag, refine_clock
from egocap.geometry import rigid
from egocap.series import interpolate

LEAST_CORRELATION = 0.6
LEAST_TURN = 0.1  # rad/s, rms; a slower head does not show its clock
MOST_PLACE_STD = 0.02  # m; a less certain place of the device is not used


@dataclass(frozen=True, eq=False)
class Alignment:
    """How a device's trajectory becomes the head's: T_ref_head(t) = T_ref_world(s) T_wd T_dh."""

    offset_s: float  # reference time less device time
    offset_std_s: float
    correlation: float  # of the angular rates
    R_device_head: Float[Array, "3 3"]
    t_device_head: Float[Array, "3"]  # m, the head's origin in the device frame
    place_std_m: float  # inf: not observable, t_device_head is 0
    T_reference_world: Float[Array, "4 4"]
    scale: float  # metres per unit of the trajectory
    residual_m: float  # rms of positions
    residual_rad: float  # rms of rotations


def angular_rates(time: Float[Array, "N"], R: Float[Array, "N 3 3"]) -> ViewSignal:
    """Angular rates in the body frame [rad/s] between successive poses."""
    turn = Rotation.from_matrix(np.swapaxes(R[:-1], 1, 2) @ R[1:]).as_rotvec()
    step = np.diff(time)
    good = step < 3.5 * np.median(step)
    return ViewSignal(0.5 * (time[1:] + time[:-1])[good], turn[good] / step[good, None])


def rate_alignment(
    reference: ViewSignal, other: ViewSignal,
    names: tuple[str, str] = ("reference", "trajectory"),
) -> tuple[float, float, float, Float[Array, "3 3"]]:  # fmt: skip
    """Offset [s], its standard deviation, correlation, and R with rate_other = R rate_reference.

    Raises InputError where the rates do not agree or hardly turn.
    """
    middle = float(other.time.mean())  # clocks of days have no small offset at time zero
    other = ViewSignal(other.time - middle, other.rate)
    size = [np.linalg.norm(s.rate, axis=1, keepdims=True) for s in (reference, other)]
    for name, rate in zip(names, size, strict=True):
        if np.sqrt((rate**2).mean()) < LEAST_TURN:
            raise InputError(
                f"the head hardly turns in the {name}: its clock cannot be found",
                valid="a motion with turns",
            )
    flat = [ViewSignal(s.time, r - r.mean())
            for s, r in zip((reference, other), size, strict=True)]  # fmt: skip
    lag, _, _ = coarse_lag(*flat)
    offset, std, R = lag, 0.0, np.eye(3)
    for _ in range(3):
        a, b = _paired(reference, other, offset)
        R = _procrustes(a, b)
        turned = ViewSignal(other.time, other.rate @ R)
        offset, _, covariance = refine_clock(reference, turned, offset)
        std = float(np.sqrt(covariance[0, 0]))
    a, b = _paired(reference, other, offset)
    turned = b @ R
    correlation = float((a * turned).sum() / np.sqrt((a**2).sum() * (turned**2).sum()))
    if not correlation > LEAST_CORRELATION:
        raise InputError(f"the {names[1]} and the {names[0]} do not turn alike (correlation "
                         f"{correlation:.2f})", valid="the same motion")  # fmt: skip
    return offset - middle, std, correlation, R


def align(
    time: Float[Array, "N"], T_world_device: Float[Array, "N 4 4"],
    reference_time: Float[Array, "M"], T_reference_head: Float[Array, "M 4 4"],
    *, free_scale: bool = False,
) -> Alignment:  # fmt: skip
    """Clock, hand-eye transform, world and scale of a trajectory. Raises as `rate_alignment`."""
    offset, std, correlation, R_dh = rate_alignment(
        angular_rates(reference_time, T_reference_head[:, :3, :3]),
        angular_rates(time, T_world_device[:, :3, :3]),
    )
    common = time + offset
    inside = (reference_time >= common[0]) & (reference_time <= common[-1])
    inside &= _near(reference_time, common)
    T_ref, at = T_reference_head[inside], reference_time[inside]
    R_wd = Slerp(common, Rotation.from_matrix(T_world_device[:, :3, :3]))(at).as_matrix()
    p_wd = interpolate(at, common, T_world_device[:, :3, 3])
    R_rw = _mean_rotation(T_ref[:, :3, :3] @ R_dh.T @ np.swapaxes(R_wd, 1, 2))
    for _ in range(3):  # both rotations together
        R_dh = _mean_rotation(np.swapaxes(R_wd, 1, 2) @ R_rw.T @ T_ref[:, :3, :3])
        R_rw = _mean_rotation(T_ref[:, :3, :3] @ R_dh.T @ np.swapaxes(R_wd, 1, 2))
    place, place_std, shift, scale, rms = _places(R_rw @ R_wd, p_wd @ R_rw.T, T_ref[:, :3, 3],
                                                  free_scale)  # fmt: skip
    off = Rotation.from_matrix(np.swapaxes(T_ref[:, :3, :3], 1, 2) @ R_rw @ R_wd @ R_dh).magnitude()
    return Alignment(offset, std, correlation, R_dh, place, place_std, rigid(R_rw, shift), scale,
                     rms, float(np.sqrt((off**2).mean())))  # fmt: skip


def aligned(T_world_device: Float[Array, "N 4 4"], found: Alignment) -> Float[Array, "N 4 4"]:
    """Head poses in the reference's world."""
    R = found.T_reference_world[:3, :3] @ T_world_device[:, :3, :3]
    p = found.scale * T_world_device[:, :3, 3] @ found.T_reference_world[:3, :3].T
    return rigid(
        R @ found.R_device_head, p + found.T_reference_world[:3, 3] + R @ found.t_device_head
    )


def _places(
    R: Float[Array, "n 3 3"], p: Float[Array, "n 3"], head: Float[Array, "n 3"], free_scale: bool
) -> tuple[Float[Array, "3"], float, Float[Array, "3"], float, float]:
    """Least squares of scale p + R x + shift = head: x, its std [m], shift, scale, rms [m]."""
    n = len(p)
    columns = [R.reshape(-1, 3), np.tile(np.eye(3), (n, 1))]
    right = head.reshape(-1)
    if free_scale:
        columns.append(p.reshape(-1, 1))
    else:
        right = right - p.reshape(-1)
    A = np.concatenate(columns, 1)
    x, *_ = np.linalg.lstsq(A, right, rcond=None)
    rms = float(np.sqrt(((A @ x - right) ** 2).mean() * 3))
    # Errors of neighbouring poses are alike: one independent pose in ten.
    spread = np.sqrt(np.trace(np.linalg.pinv(A.T @ A)[:3, :3]) * 10.0) * max(rms, 1e-3)
    if spread <= MOST_PLACE_STD:
        return x[:3], float(spread), x[3:6], float(x[6]) if free_scale else 1.0, rms
    A, kept = A[:, 3:], slice(3, None)
    x, *_ = np.linalg.lstsq(A, right, rcond=None)
    rms = float(np.sqrt(((A @ x - right) ** 2).mean() * 3))
    return np.zeros(3), np.inf, x[:3], float(x[kept][0]) if free_scale else 1.0, rms


def _paired(a: ViewSignal, b: ViewSignal, offset: float) -> tuple[Array, Array]:
    """Rates of both at the times of a where b has them."""
    own = a.time - offset
    inside = (own >= b.time[0]) & (own <= b.time[-1])
    if inside.sum() < 10:
        raise InputError("the trajectory and the reference hardly overlap in time",
                         valid="the same motion")  # fmt: skip
    other = interpolate(own[inside], b.time, b.rate[:, :3])
    return a.rate[inside], other


def _procrustes(a: Float[Array, "n 3"], b: Float[Array, "n 3"]) -> Float[Array, "3 3"]:
    """R with b = R a, robust to single wrong rates."""
    weight, R = np.ones(len(a)), np.eye(3)
    for _ in range(5):
        U, _, Vt = np.linalg.svd((b * weight[:, None]).T @ a)
        R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
        error = np.linalg.norm(b - a @ R.T, axis=1)
        scale = max(2.0 * float(np.median(error)), 1e-6)
        weight = 1.0 / (1.0 + (error / scale) ** 2) ** 2
    return R


def _mean_rotation(R: Float[Array, "n 3 3"]) -> Float[Array, "3 3"]:
    """The rotation nearest to the mean matrix."""
    U, _, Vt = np.linalg.svd(R.mean(0))
    return U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt


def _near(times: Float[Array, "M"], known: Float[Array, "N"]) -> Array:
    """Whether a known pose lies within three median steps before and after."""
    after = np.clip(np.searchsorted(known, times), 1, len(known) - 1)
    return known[after] - known[after - 1] <= 3.0 * np.median(np.diff(known))
