"""A reference as joint coordinates, velocities and accelerations at the simulation's rate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.interpolate import CubicSpline

from egocap.geometry import matrix_to_quaternion, unit
from egocap_sim.core.bodies import PARENTS
from egocap_sim.motion.kinematics.curves import continuous
from egocap_sim.motion.retarget.retarget import Reference

BLOCK = 1024  # steps computed at once: bounds memory for long motions


@dataclass(frozen=True, eq=False)
class Target:
    """Target state at the steps of one block, in MuJoCo's coordinates."""

    qpos: Float[Array, "N 87"]
    qvel: Float[Array, "N 66"]  # half a step earlier, as in semi-implicit Euler
    qacc: Float[Array, "N 66"]
    planted: Bool[Array, "N 4"]
    touching: Bool[Array, "N 4"]


class TargetMotion:
    """Cubic splines through a reference's coordinates, evaluated in blocks.

    The angular velocity of a unit quaternion q in the body's own frame is 2 vec(q* q'), its
    acceleration 2 vec(q* q''); both are taken from the spline, not from differences.
    """

    def __init__(self, reference: Reference) -> None:
        parents = np.array(PARENTS[1:])
        R = reference.rotations
        local = np.concatenate([R[:, :1], np.swapaxes(R[:, parents], -1, -2) @ R[:, 1:]], 1)
        q = continuous(matrix_to_quaternion(local))
        self._fps = reference.fps
        self._planted, self._touching = reference.planted, reference.touching
        self._last = (len(R) - 1) / reference.fps
        times = np.arange(len(R)) / reference.fps
        keys = np.concatenate([reference.root, q.reshape(len(R), -1)], 1)
        self._spline = CubicSpline(times, keys, axis=0)

    def block(self, first: int, count: int, timestep_s: float, start_s: float) -> Target:
        """Targets of steps first .. first + count - 1, of which step 0 is at `start_s`.

        The first pose is held before the beginning, the last beyond the end.
        """
        steps = first + np.arange(count)
        times = start_s + steps * timestep_s
        qpos, qacc = self._positions(times)
        qvel = self._velocities(times - timestep_s / 2)
        early = steps < -start_s / timestep_s
        qvel[early] = qacc[early] = 0.0
        frame = np.clip(np.rint(times * self._fps).astype(int), 0, len(self._planted) - 1)
        return Target(qpos, qvel, qacc, self._planted[frame], self._touching[frame])

    def _positions(
        self, times: Float[Array, "N"]
    ) -> tuple[Float[Array, "N 87"], Float[Array, "N 66"]]:
        """Coordinates and accelerations."""
        (x, q), (_, dq), (ddx, ddq) = (self._splined(times, order) for order in range(3))
        square = (q * q).sum(-1, keepdims=True)
        omega = 2 * _imaginary(q, dq) / square
        alpha = (
            2 * _imaginary(q, ddq) / square - omega * 2 * (q * dq).sum(-1, keepdims=True) / square
        )
        n = len(times)
        return (
            np.concatenate([x, unit(q).reshape(n, -1)], 1),
            np.concatenate([ddx, alpha.reshape(n, -1)], 1),
        )

    def _velocities(self, times: Float[Array, "N"]) -> Float[Array, "N 66"]:
        (_, q), (dx, dq) = (self._splined(times, order) for order in range(2))
        omega = 2 * _imaginary(q, dq) / (q * q).sum(-1, keepdims=True)
        return np.concatenate([dx, omega.reshape(len(times), -1)], 1)

    def _splined(
        self, times: Float[Array, "N"], order: int
    ) -> tuple[Float[Array, "N 3"], Float[Array, "N 21 4"]]:
        """A derivative of the root's position and of all quaternions; zero beyond the end."""
        values = self._spline(np.clip(times, 0.0, self._last), order)
        if order:
            values[times > self._last] = 0.0
        return values[:, :3], values[:, 3:].reshape(len(times), -1, 4)


def _imaginary(a: Float[Array, "*n 4"], b: Float[Array, "*n 4"]) -> Float[Array, "*n 3"]:
    """Vector part of the product conj(a) b."""
    w, x, y, z = np.moveaxis(a, -1, 0)
    s, u, v, t = np.moveaxis(b, -1, 0)
    rows = (w * u - s * x - (y * t - z * v), w * v - s * y - (z * u - x * t),
            w * t - s * z - (x * v - y * u))  # fmt: skip
    return np.stack(rows, -1)
