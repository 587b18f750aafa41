"""The ray of every pixel of a camera, fast: the lens is inverted along one radius, not everywhere.

`egocap.camera.Camera.ray` is what this is tested against.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.camera import Camera

_STEPS = 8192  # of the table over radii: within 1e-7 rad of the inverse of any lens that is smooth


@lru_cache(maxsize=2)
def pixel_rays(camera: Camera) -> tuple[Float[Array, "H W 3"], Float[Array, "H W"]]:
    """Unit rays in the camera frame and angles off the axis [rad] of all pixels; do not write."""
    (a, b), (c, d) = np.linalg.inv(np.array(camera.affine))
    u = np.arange(camera.width) - camera.centre[0]
    v = (np.arange(camera.height) - camera.centre[1])[:, None]
    x, y = a * u + b * v, c * u + d * v
    radius = np.maximum(np.sqrt(x * x + y * y), 1e-12)
    table = np.linspace(0.0, float(radius.max()), _STEPS)
    theta = np.interp(radius, table, camera.radial.angle(table))
    share = np.sin(theta) / radius
    rays = np.stack([x * share, y * share, np.cos(theta)], -1)
    for array in (rays, theta):
        array.flags.writeable = False
    return rays, theta
