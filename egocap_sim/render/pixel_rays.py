"""Rays of all pixels of a camera, with the lens inverted once along the radius.

The tests compare it with `egocap.cameras.camera.Camera.ray`.
"""

from __future__ import annotations

from functools import lru_cache

import numba
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.cameras.camera import Camera

_STEPS = 8192  # of the table over radii: accurate to 1e-7 rad for smooth lenses


@lru_cache(maxsize=2)
def pixel_rays(camera: Camera) -> tuple[Float[Array, "H W 3"], Float[Array, "H W"]]:
    """Unit rays in the camera frame and angles off the axis [rad] of all pixels; do not write."""
    to_plane = np.linalg.inv(np.array(camera.affine))
    u = np.arange(camera.width) - camera.centre[0]
    v = np.arange(camera.height) - camera.centre[1]
    corners = np.stack(np.meshgrid(u[[0, -1]], v[[0, -1]]), -1) @ to_plane.T
    table = np.linspace(0.0, float(np.linalg.norm(corners, axis=-1).max()), _STEPS)
    rays, theta = _interpolate_rays(u, v, to_plane, table[1], camera.radial.angle(table))
    for array in (rays, theta):
        array.flags.writeable = False
    return rays, theta


@numba.njit(cache=True)
def _interpolate_rays(
    u: Float[Array, "W"],
    v: Float[Array, "H"],
    to_plane: Float[Array, "2 2"],
    step: float,
    angle: Float[Array, "N"],
) -> tuple[Float[Array, "H W 3"], Float[Array, "H W"]]:
    """`pixel_rays`, given pixels from the centre and the angle at every `step` of the radius."""
    rays, theta = np.empty((len(v), len(u), 3)), np.empty((len(v), len(u)))
    sine, cosine = np.sin(angle), np.cos(angle)
    for j in range(len(v)):
        for i in range(len(u)):
            x = to_plane[0, 0] * u[i] + to_plane[0, 1] * v[j]
            y = to_plane[1, 0] * u[i] + to_plane[1, 1] * v[j]
            radius = max(np.sqrt(x * x + y * y), 1e-12)
            k = min(int(radius / step), len(angle) - 2)
            share = radius / step - k
            s = sine[k] + share * (sine[k + 1] - sine[k])
            c = cosine[k] + share * (cosine[k + 1] - cosine[k])
            unit = 1.0 / np.sqrt(
                s * s + c * c
            )  # interpolated points lie slightly inside the circle
            rays[j, i, 0] = x / radius * s * unit
            rays[j, i, 1] = y / radius * s * unit
            rays[j, i, 2] = c * unit
            theta[j, i] = angle[k] + share * (angle[k + 1] - angle[k])
    return rays, theta
