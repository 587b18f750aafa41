"""Compiled rays of pixels, for one frame at a time: `Camera.ray` and `Camera.project_jacobian`.

On a frame's few detections numpy spends its time on calls. The camera's methods are the readable
reference implementation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numba import njit
from numpy import ndarray as Array

from egocap.cameras.camera import ANGLE_SLACK, TINY, Camera
from egocap.cameras.lens import NEWTON_STEPS


class Lens(NamedTuple):
    """A camera as plain numbers and arrays."""

    size: tuple[float, float]  # width and height in pixels
    centre: tuple[float, float]
    affine: Float[Array, "2 2"]
    inverse: Float[Array, "2 2"]  # of `affine`
    coefficients: Float[Array, "K"]  # of `egocap.cameras.lens.Radial`, as the next three
    limit: float
    middle: float
    half: float
    max_angle: float  # rad


def make_lens(camera: Camera) -> Lens:
    """The numbers of a camera."""
    affine, radial = np.array(camera.affine), camera.radial
    return Lens(
        (float(camera.width), float(camera.height)), camera.centre, affine, np.linalg.inv(affine),
        np.array(radial.coefficients), float(radial.limit), float(radial.middle),
        float(radial.half), float(camera.max_angle),
    )  # fmt: skip


def cast(
    lens: Lens, pixels: Float[Array, "*batch 2"]
) -> tuple[Float[Array, "*batch 3"], Float[Array, "*batch 2 3"], Bool[Array, "*batch"]]:
    """Unit rays of pixels, the pixels' derivatives by the rays [px], and validity of the pixels."""
    batch = pixels.shape[:-1]
    rays, J, seen = np.empty((*batch, 3)), np.empty((*batch, 2, 3)), np.empty(batch, bool)
    flat = np.ascontiguousarray(pixels, float).reshape(-1, 2)
    _cast(lens, flat, rays.reshape(-1, 3), J.reshape(-1, 2, 3), seen.reshape(-1))
    return rays, J, seen


@njit(cache=True, nogil=True, error_model="numpy")
def _cast(lens, pixels, rays, J, seen):
    edge, edge_slope = _radius(lens, lens.limit)
    for i in range(len(pixels)):
        u, v = pixels[i, 0] - lens.centre[0], pixels[i, 1] - lens.centre[1]
        x = lens.inverse[0, 0] * u + lens.inverse[0, 1] * v
        y = lens.inverse[1, 0] * u + lens.inverse[1, 1] * v
        radius = np.sqrt(max(x * x + y * y, TINY))
        theta = _angle(lens, radius, edge, edge_slope)
        s = np.sin(theta) / radius
        x, y, z = x * s, y * s, np.cos(theta)
        rays[i, 0], rays[i, 1], rays[i, 2] = x, y, z
        inside = (pixels[i, 0] >= -0.5 and pixels[i, 0] <= lens.size[0] - 0.5
                  and pixels[i, 1] >= -0.5 and pixels[i, 1] <= lens.size[1] - 0.5)  # fmt: skip
        seen[i] = inside and theta <= lens.max_angle + ANGLE_SLACK
        rho = np.sqrt(max(x * x + y * y, TINY))
        radius, slope = _radius(lens, np.arctan2(rho, z))
        m, dx, dy, d2 = radius / rho, x / rho, y / rho, rho * rho + z * z
        radial, axial = slope * z / d2 - m, -slope * rho / d2
        for r in range(2):
            a, b = lens.affine[r, 0], lens.affine[r, 1]
            J[i, r, 0] = a * (m + dx * dx * radial) + b * dx * dy * radial
            J[i, r, 1] = a * dx * dy * radial + b * (m + dy * dy * radial)
            J[i, r, 2] = (a * dx + b * dy) * axial


@njit(cache=True, nogil=True, error_model="numpy")
def _radius(lens, theta):
    """`Radial.radius` of one angle."""
    inner = min(theta, lens.limit)
    s = (inner - lens.middle) / lens.half
    q = dq = 0.0
    for k in range(len(lens.coefficients) - 1, -1, -1):
        dq = dq * s + q
        q = q * s + lens.coefficients[k]
    slope = q + inner * dq / lens.half
    return inner * q + slope * (theta - inner), slope


@njit(cache=True, nogil=True, error_model="numpy")
def _angle(lens, radius, edge, edge_slope):
    """`Radial.angle` of one radius; `edge` and its slope are those at the lens's limit."""
    target, tolerance = min(radius, edge), 4.0 * np.finfo(np.float64).eps * lens.limit
    low, x, top = 0.0, target * (lens.limit / edge), lens.limit
    for _ in range(NEWTON_STEPS):
        value, slope = _radius(lens, x)
        if value <= target:
            low = x
        if value >= target:
            top = x
        step = x - (value - target) / (slope if slope > 0.0 else 1.0)
        new = step if low <= step <= top else 0.5 * (low + top)
        moved, x = abs(new - x), new
        if not moved > tolerance:
            break
    theta = x + max(radius - edge, 0.0) / edge_slope
    value, slope = _radius(lens, theta)
    return theta - (value - radius) / slope
