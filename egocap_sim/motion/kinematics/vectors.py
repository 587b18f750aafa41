"""Vectors and rotations as tuples, for compiled loops without array allocation.

A rotation is the tuple of its three columns.
"""

from __future__ import annotations

import math

from jaxtyping import Float
from numba import njit
from numpy import ndarray as Array

Vector = tuple[float, float, float]
Axes = tuple[Vector, Vector, Vector]

_STRAIGHT = 1e-12  # of a sine or 1 + cosine: the axis is undefined below


@njit(cache=True)
def vector(a: Float[Array, "3"]) -> Vector:
    return a[0], a[1], a[2]


@njit(cache=True)
def axes(R: Float[Array, "3 3"]) -> Axes:
    return vector(R[:, 0]), vector(R[:, 1]), vector(R[:, 2])


@njit(cache=True)
def put(R: Float[Array, "3 3"], a: Axes) -> None:
    """Write a rotation into an array."""
    for row in range(3):
        R[row, 0], R[row, 1], R[row, 2] = a[0][row], a[1][row], a[2][row]


@njit(cache=True)
def plus(a: Vector, b: Vector, times: float = 1.0) -> Vector:
    """a + times b."""
    return a[0] + times * b[0], a[1] + times * b[1], a[2] + times * b[2]


@njit(cache=True)
def difference(a: Float[Array, "3"], b: Float[Array, "3"]) -> Vector:
    """a - b of rows of arrays."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@njit(cache=True)
def scaled(a: Vector, factor: float) -> Vector:
    return factor * a[0], factor * a[1], factor * a[2]


@njit(cache=True)
def dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True)
def cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True)
def length(a: Vector) -> float:
    return math.sqrt(dot(a, a))


@njit(cache=True)
def unit(a: Vector) -> Vector:
    """Of length one; a zero vector stays zero."""
    n = length(a)
    return scaled(a, 1.0 / n) if n > 0.0 else a


@njit(cache=True)
def mirrored(a: Vector, sign: float) -> Vector:
    """Multiply y by a sign: -1 exchanges left and right."""
    return a[0], sign * a[1], a[2]


@njit(cache=True)
def applied(R: Axes, v: Vector) -> Vector:
    """R v."""
    return plus(plus(scaled(R[0], v[0]), R[1], v[1]), R[2], v[2])


@njit(cache=True)
def product(A: Axes, B: Axes) -> Axes:
    """A B."""
    return applied(A, B[0]), applied(A, B[1]), applied(A, B[2])


@njit(cache=True)
def about(axis: Vector, angle: float) -> Axes:
    """The rotation about a unit axis by an angle, as `egocap.geometry.axis_angle`."""
    c, s = math.cos(angle), math.sin(angle)
    x, y, z = axis
    d = 1.0 - c
    return (
        (c + d * x * x, d * x * y + s * z, d * x * z - s * y),
        (d * x * y - s * z, c + d * y * y, d * y * z + s * x),
        (d * x * z + s * y, d * y * z - s * x, c + d * z * z),
    )


@njit(cache=True)
def turned(yaw: float, pitch: float, roll: float) -> Axes:
    """Roll about x, then pitch about y, then yaw about z, as `curves.turn`."""
    cy, sy, cp, sp = math.cos(yaw), math.sin(yaw), math.cos(pitch), math.sin(pitch)
    cr, sr = math.cos(roll), math.sin(roll)
    return (
        (cy * cp, sy * cp, -sp),
        (cy * sp * sr - sy * cr, sy * sp * sr + cy * cr, cp * sr),
        (cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr),
    )


@njit(cache=True)
def arc(a: Vector, b: Vector) -> Axes:
    """The smallest rotation that turns unit vector a into b, as `limbs.shortest_arc`."""
    v, c = cross(a, b), dot(a, b)
    x, y, z = v
    d = 1.0 / max(1.0 + c, _STRAIGHT)
    return (
        (c + d * x * x, d * x * y + z, d * x * z - y),
        (d * x * y - z, c + d * y * y, d * y * z + x),
        (d * x * z + y, d * y * z - x, c + d * z * z),
    )


@njit(cache=True)
def part_way(A: Axes, B: Axes, share: float) -> Axes:
    """Rotate from A towards B by a share of their angle, which is below pi."""
    twice = plus(plus(cross(A[0], B[0]), cross(A[1], B[1])), cross(A[2], B[2]))  # axis 2 sin, world
    cosine = 0.5 * (dot(A[0], B[0]) + dot(A[1], B[1]) + dot(A[2], B[2]) - 1.0)
    sine = 0.5 * length(twice)
    if sine < _STRAIGHT:
        return A
    return product(about(scaled(twice, 0.5 / sine), share * math.atan2(sine, cosine)), A)
