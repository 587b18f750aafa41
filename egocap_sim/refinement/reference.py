"""A tracked motion as coordinates, velocities and accelerations at any time.

Errors of a track change from frame to frame, and accelerations would consist of them: coordinates
pass a low-pass filter first, forwards and backwards, as joint positions do in gait analysis.

Source: Winter 2009, "Biomechanics and Motor Control of Human Movement", section 3.4.4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

from egocap.data.track import Track
from egocap.geometry import matrix_to_quaternion, unit
from egocap_sim.motion.kinematics.curves import continuous
from egocap_sim.refinement.humanoid import HINGES

_PADDING = 15  # frames by which the ends are prolonged, point-reflected, to filter


@dataclass(frozen=True, eq=False)
class Reference:
    """Cubic splines through the coordinates of the humanoid: head and angles."""

    spline: CubicSpline  # of (N, 44)

    @classmethod
    def of(cls, track: Track, frames: Int[Array, "n"], cutoff_hz: float) -> Reference:
        """Through the filtered poses of a track in the world, of two frames or more."""
        assert track.T_world_head is not None
        heads = track.T_world_head[frames]
        q = continuous(matrix_to_quaternion(heads[:, :3, :3]))
        angles = track.angles[np.ix_(frames, HINGES)]
        poses = np.concatenate([heads[:, :3, 3], q, angles], 1)
        times = track.times[frames]
        share = 2.0 * cutoff_hz * float(np.median(np.diff(times)))  # of the highest frequency
        if share < 1.0:
            low_pass = butter(2, share, output="sos")
            poses = sosfiltfilt(low_pass, poses, axis=0, padlen=min(_PADDING, len(poses) - 1))
        return cls(CubicSpline(times, poses))

    def positions(self, times: Float[Array, "N"]) -> Float[Array, "N 44"]:
        """MuJoCo's qpos."""
        at = self.spline(times)
        at[:, 3:7] = unit(at[:, 3:7])
        return np.asarray(at)

    def velocities(self, times: Float[Array, "N"]) -> Float[Array, "N 43"]:
        """MuJoCo's qvel: the head turns in its own frame, at 2 vec(q* q')."""
        at, rate = self.spline(times), self.spline(times, 1)
        turning, _ = _turning(at[:, 3:7], rate[:, 3:7])
        return np.concatenate([rate[:, :3], turning, rate[:, 7:]], 1)

    def accelerations(self, times: Float[Array, "N"]) -> Float[Array, "N 43"]:
        """Derivatives of the velocities."""
        at, rate, second = (self.spline(times, order) for order in range(3))
        turning, length = _turning(at[:, 3:7], rate[:, 3:7])
        faster, _ = _turning(at[:, 3:7], second[:, 3:7])
        along = 2.0 * (at[:, 3:7] * rate[:, 3:7]).sum(1, keepdims=True) / length
        return np.concatenate([second[:, :3], faster - along * turning, second[:, 7:]], 1)


def _turning(
    q: Float[Array, "N 4"], derivative: Float[Array, "N 4"]
) -> tuple[Float[Array, "N 3"], Float[Array, "N 1"]]:
    """2 vec(q* derivative) / |q|^2, and |q|^2."""
    w, v = q[:, :1], q[:, 1:]
    dw, dv = derivative[:, :1], derivative[:, 1:]
    length = (q * q).sum(1, keepdims=True)
    return 2.0 * (w * dv - dw * v - np.cross(v, dv)) / length, length
