"""Curves of procedural motions: minimum jerk, slow noise, Hermite splines, Euler rotations.

Source: T. Flash and N. Hogan, The coordination of arm movements (J. Neuroscience 5, 1985), for the
minimum-jerk profile.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array


def minimum_jerk(x: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Rise from 0 to 1 over 0..1 with zero velocity and acceleration at both ends; held outside."""
    x = np.clip(x, 0.0, 1.0)
    return x * x * x * (10.0 + x * (6.0 * x - 15.0))


def through(
    t: Float[Array, "T"],
    times: Sequence[float],
    values: Float[Array, "K *D"],
    bulge: Float[Array, "*D"] | float = 0.0,
) -> Float[Array, "T *D"]:
    """Minimum-jerk moves through keys at increasing times; the first and the last are held.

    Halfway between two keys the curve is `bulge` times their distance off the straight line.
    """
    at, values = np.asarray(times, float), np.asarray(values, float)
    if len(at) == 1:
        return np.broadcast_to(values[0], (len(t), *values.shape[1:])).copy()
    k = np.clip(np.searchsorted(at, t, side="right") - 1, 0, len(at) - 2)
    s = minimum_jerk((t - at[k]) / np.maximum(at[k + 1] - at[k], 1e-6))
    s = s.reshape(-1, *[1] * (values.ndim - 1))
    move = values[k + 1] - values[k]
    curve = values[k] + s * move
    if values.ndim > 1:
        distance = np.linalg.norm(move, axis=-1, keepdims=True)
        curve = curve + 4.0 * s * (1.0 - s) * distance * bulge
    return curve


def slow_noise(
    t: Float[Array, "T"], rng: np.random.Generator, lowest: float, highest: float, waves: int = 5
) -> Float[Array, "T"]:
    """Smooth random signal of standard deviation about 1, of frequencies in a band [Hz]."""
    f = np.exp(rng.uniform(np.log(lowest), np.log(highest), waves))
    phase = rng.uniform(0.0, 2.0 * np.pi, waves)
    waves_ = np.sin(2.0 * np.pi * np.outer(t, f) + phase)
    return waves_.sum(1) * np.sqrt(2.0 / waves)


def turn(
    yaw: Float[Array, "*n"] | float = 0.0,
    pitch: Float[Array, "*n"] | float = 0.0,
    roll: Float[Array, "*n"] | float = 0.0,
) -> Float[Array, "*n 3 3"]:
    """Rotations that roll about x, then pitch about y (positive: forward), then yaw about z."""
    angles = [np.asarray(a, float) for a in (yaw, pitch, roll)]
    (cy, cp, cr), (sy, sp, sr) = map(np.cos, angles), map(np.sin, angles)
    R = np.empty((*np.broadcast_shapes(*(a.shape for a in angles)), 3, 3))
    R[..., 0, 0], R[..., 1, 0], R[..., 2, 0] = cy * cp, sy * cp, -sp
    R[..., 0, 1], R[..., 1, 1] = cy * sp * sr - sy * cr, sy * sp * sr + cy * cr
    R[..., 0, 2], R[..., 1, 2] = cy * sp * cr + sy * sr, sy * sp * cr - cy * sr
    R[..., 2, 1], R[..., 2, 2] = cp * sr, cp * cr
    return R


def wrap_angle(angle: float) -> float:
    """The same angle [rad] within -pi .. pi."""
    return float((angle + np.pi) % (2.0 * np.pi) - np.pi)


def continuous(q: Float[Array, "T *batch 4"]) -> Float[Array, "T *batch 4"]:
    """Choose the signs of quaternions along time so that neighbours are in the same hemisphere."""
    flips = np.where((q[1:] * q[:-1]).sum(-1, keepdims=True) < 0, -1.0, 1.0)
    return np.concatenate([q[:1], q[1:] * np.cumprod(flips, axis=0)])


def hermite(
    s: Float[Array, "T"], a: Array, b: Array, slope_a: Array, slope_b: Array
) -> Float[Array, "T 3"]:
    """Cubic curve over s in 0..1 between points with given slopes (per unit of s)."""
    s = s[:, None]
    return (
        (1 + 2 * s) * (1 - s) ** 2 * a
        + s * s * (3 - 2 * s) * b
        + s * (1 - s) ** 2 * slope_a
        - s * s * (1 - s) * slope_b
    )
