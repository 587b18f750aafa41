"""The cube around a camera: the face and the face point of every pixel's ray.

Faces use the OpenCV convention (x right, y down, z out of the face); a face point has slopes
u = x/z and v = y/z within -1..1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache
from math import pi
from typing import Protocol

import numba
import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from egocap.cameras.camera import Camera
from egocap_sim.render.pixel_rays import pixel_rays

TILE_COST = 0.15  # fixed cost of one more face, in squares of a face's half width
_STRIDE = 4  # of the pixels, when a cube is chosen


class Lens(Protocol):
    """Interface of a camera, as in `egocap.cameras.camera`."""

    @property
    def width(self) -> int: ...

    @property
    def height(self) -> int: ...

    @property
    def max_angle(self) -> float: ...

    def ray(self, pixels: Float[Array, "*n 2"]) -> tuple[Array, Array]: ...


@dataclass(frozen=True, eq=False)
class PixelTrace:
    """Intersections of a camera's pixel rays with the cube that is cheapest to draw."""

    faces: Float[Array, "6 3 3"]  # R_camera_face
    face: Int[Array, "H W"]  # int8; -1 outside the lens
    slopes: Float[Array, "H W 2"]  # u and v
    bounds: Float[Array, "6 4"]  # u0, u1, v0, v1 of the visible part of a face; infinite if none

    @property
    def seen(self) -> list[int]:
        """The faces that some pixel ray crosses."""
        return np.flatnonzero(np.isfinite(self.bounds[:, 0])).tolist()


@lru_cache(maxsize=2)
def trace_pixels(camera: Lens) -> PixelTrace:
    """Choose the cube around a camera and trace every pixel to it."""
    rays, inside = _rays(camera)
    faces = _cheapest_cube(rays[::_STRIDE, ::_STRIDE], inside[::_STRIDE, ::_STRIDE])
    return PixelTrace(faces, *_trace(rays, inside, faces))


def cube_face(directions: Float[Array, "*n 3"], faces: Float[Array, "6 3 3"]) -> Int[Array, "*n"]:
    """Index of the cube face each direction leaves through."""
    return np.argmax(directions @ faces[:, :, 2].T, -1)


@numba.njit(cache=True)
def _trace(
    rays: Float[Array, "H W 3"], inside: Bool[Array, "H W"], faces: Float[Array, "6 3 3"]
) -> tuple[Array, Array, Array]:
    """`PixelTrace.face`, `slopes` and `bounds`; `cube_face` is the readable form of the first."""
    height, width = inside.shape
    face = np.full((height, width), -1, np.int8)
    slopes = np.zeros((height, width, 2))
    bounds = np.empty((6, 4))
    bounds[:, 0::2], bounds[:, 1::2] = np.inf, -np.inf
    for y in range(height):
        for x in range(width):
            if inside[y, x]:
                a, b, c = rays[y, x, 0], rays[y, x, 1], rays[y, x, 2]
                f, depth = 0, -np.inf
                for i in range(6):
                    along = a * faces[i, 0, 2] + b * faces[i, 1, 2] + c * faces[i, 2, 2]
                    if along > depth:
                        f, depth = i, along
                face[y, x] = f
                for k in range(2):
                    across = a * faces[f, 0, k] + b * faces[f, 1, k] + c * faces[f, 2, k]
                    slope = across / depth
                    slopes[y, x, k] = slope
                    bounds[f, 2 * k] = min(bounds[f, 2 * k], slope)
                    bounds[f, 2 * k + 1] = max(bounds[f, 2 * k + 1], slope)
    return face, slopes, bounds


def _rays(camera: Lens) -> tuple[Array, Array]:
    if isinstance(camera, Camera):
        rays, angle = pixel_rays(camera)
        return rays, angle <= camera.max_angle
    x, y = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays, valid = camera.ray(np.stack([x, y], -1).astype(float))
    angle = np.arctan2(np.hypot(rays[..., 0], rays[..., 1]), rays[..., 2])
    return rays, valid & (angle <= camera.max_angle)


@cache
def _cubes() -> tuple[Float[Array, "6 3 3"], ...]:
    """Candidate cubes: an edge on the axis (vertical or horizontal), or a face on the axis."""
    cube = [_turn(1, a) for a in (0, pi / 2, pi, -pi / 2)] + [
        _turn(0, a) for a in (pi / 2, -pi / 2)
    ]
    return tuple(
        np.stack([_turn(axis, angle) @ R for R in cube])
        for axis, angle in ((1, pi / 4), (0, pi / 4), (0, 0))
    )


def _turn(axis: int, angle: float) -> Array:
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[i, i] = R[j, j] = np.cos(angle)
    R[j, i], R[i, j] = np.sin(angle), -np.sin(angle)
    return R


def _cheapest_cube(
    rays: Float[Array, "h w 3"], inside: Bool[Array, "h w"]
) -> Float[Array, "6 3 3"]:
    """The cube with the least area to draw, in squares of a face's half width, and fewest tiles."""
    du, dv = np.gradient(rays, axis=(1, 0))
    solid_angle = np.linalg.norm(np.cross(du, dv), axis=-1)[inside]
    rays = rays[inside]

    def cost(faces: Array) -> float:
        face = cube_face(rays, faces)
        outward = np.einsum("ni,ni->n", rays, faces[face, :, 2])  # cosine to the face's axis
        drawn = np.sum(solid_angle / outward**3)
        return float(drawn) + TILE_COST * len(np.unique(face))

    return min(_cubes(), key=cost)
