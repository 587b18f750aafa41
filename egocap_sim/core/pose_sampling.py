"""Bodies at any instant: a simulated motion sampled finely, interpolated between its samples."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numba import njit
from numpy import ndarray as Array

from egocap.geometry import matrix_to_quaternion


@dataclass(frozen=True, eq=False)
class SampledPoses:
    """Poses of bodies at `rate` samples a second, the first at `start_s`.

    Positions are interpolated linearly, rotations by slerp. At the rate of the physics (at least
    250 Hz) and an acceleration of 100 m/s^2 the error is within a dt^2 / 8 = 0.2 mm. The poses are
    constant before the first and after the last sample.
    """

    rate: float  # Hz
    poses: Float[Array, "N B 7"]  # position (m) and quaternion (w, x, y, z)
    start_s: float = 0.0

    @classmethod
    def from_transforms(
        cls, T_world_body: Float[Array, "N B 4 4"], rate: float, start_s: float = 0.0
    ) -> SampledPoses:
        """From transforms."""
        quaternions = matrix_to_quaternion(T_world_body[..., :3, :3])
        return cls(rate, np.concatenate([T_world_body[..., :3, 3], quaternions], -1), start_s)

    @property
    def end_s(self) -> float:
        """Time of the last sample."""
        return self.start_s + (len(self.poses) - 1) / self.rate

    def at(self, times: Float[Array, "*n"] | float) -> Float[Array, "*n B 4 4"]:
        """Poses of all bodies at times in seconds."""
        return self.at_bodies(np.asarray(times)[..., None], np.arange(self.poses.shape[1]))

    def at_bodies(self, times: Float[Array, "*n"], bodies: Int[Array, "*n"]) -> Array:
        """Poses (*n, 4, 4) of bodies, each at its own time; the two shapes broadcast."""
        place = (np.asarray(times, float) - self.start_s) * self.rate
        place = np.clip(place, 0, len(self.poses) - 1)
        first = np.floor(place).astype(int)
        second = np.minimum(first + 1, len(self.poses) - 1)
        return between(self.poses[first, bodies], self.poses[second, bodies], place - first)

    def save(self, path: Path) -> None:
        """Write the samples; `load` maps the file into memory."""
        with path.open("wb") as file:
            np.save(file, self.poses)

    @classmethod
    def load(cls, path: Path, rate: float, start_s: float = 0.0) -> SampledPoses:
        """Open saved samples."""
        return cls(rate, np.load(path, mmap_mode="r"), start_s)


def between_frames(T: Float[Array, "T B 4 4"], place: float) -> Float[Array, "B 4 4"]:
    """Rigid transforms at a fractional frame number up to T - 1; below 0 they are extrapolated."""
    first = min(max(int(place), 0), len(T) - 1)
    if place == first or len(T) == 1:
        return T[first]
    pair = SampledPoses.from_transforms(T[first : first + 2], 1.0).poses
    return between(pair[0], pair[1], place - first)


def between(
    a: Float[Array, "*n 7"], b: Float[Array, "*n 7"], share: Float[Array, "*n"] | float
) -> Float[Array, "*n 4 4"]:
    """Transforms a share of the way from poses a to poses b, the shorter way around."""
    share = np.asarray(share)[..., None]
    position = (1.0 - share) * a[..., :3] + share * b[..., :3]
    T = np.zeros((*position.shape[:-1], 4, 4))
    T[..., :3, 3], T[..., 3, 3] = position, 1.0
    q = slerp(a[..., 3:], b[..., 3:], share[..., 0])
    _set_rotations(T.reshape(-1, 4, 4), q.reshape(-1, 4))
    return T


def slerp(
    p: Float[Array, "*n 4"], q: Float[Array, "*n 4"], share: Float[Array, "*n"] | float
) -> Float[Array, "*n 4"]:
    """Unit quaternions a share of the way from p to q, the shorter way around."""
    shape = np.broadcast_shapes(p.shape[:-1], q.shape[:-1], np.shape(share))
    p, q = (np.array(np.broadcast_to(a, (*shape, 4)), order="C") for a in (p, q))
    shares = np.array(np.broadcast_to(share, shape), float, order="C")
    _turn_towards(p.reshape(-1, 4), q.reshape(-1, 4), shares.reshape(-1))
    return p


@njit(cache=True)
def _turn_towards(p: Float[Array, "N 4"], q: Float[Array, "N 4"], share: Float[Array, "N"]) -> None:
    """Slerp in place."""
    for n in range(len(p)):
        cosine, sign = 0.0, 1.0
        for i in range(4):
            cosine += p[n, i] * q[n, i]
        if cosine < 0.0:
            cosine, sign = -cosine, -1.0
        angle = math.acos(min(cosine, 1.0))
        wp, wq = 1.0 - share[n], share[n]
        if angle >= 1e-6:  # otherwise linear weights: the ratio of sines would be 0 / 0
            sine = math.sin(angle)
            wp, wq = math.sin(wp * angle) / sine, math.sin(wq * angle) / sine
        for i in range(4):
            p[n, i] = wp * p[n, i] + wq * sign * q[n, i]


@njit(cache=True)
def _set_rotations(T: Float[Array, "N 4 4"], q: Float[Array, "N 4"]) -> None:
    """Like `egocap.geometry.quaternion_to_matrix`, in place."""
    for n in range(len(T)):
        w, x, y, z = q[n, 0], q[n, 1], q[n, 2], q[n, 3]
        s = 2.0 / (w * w + x * x + y * y + z * z)
        T[n, 0, 0] = 1.0 - s * (y * y + z * z)
        T[n, 0, 1] = s * (x * y - w * z)
        T[n, 0, 2] = s * (x * z + w * y)
        T[n, 1, 0] = s * (x * y + w * z)
        T[n, 1, 1] = 1.0 - s * (x * x + z * z)
        T[n, 1, 2] = s * (y * z - w * x)
        T[n, 2, 0] = s * (x * z - w * y)
        T[n, 2, 1] = s * (y * z + w * x)
        T[n, 2, 2] = 1.0 - s * (x * x + y * y)
