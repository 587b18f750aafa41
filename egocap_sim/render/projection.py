"""Projection matrices of tiles and lights, depth conversion and frustum culling."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap import geometry
from egocap_sim.render.fisheye import Tile

SHADOW_HALF_WIDTH = 3.5  # metres around the wearer that the shadow map covers
SHADOW_DEPTH = 16.0  # metres along the light that its depth, 0..1, covers
TO_TEXTURE = np.array(
    [[0.5, 0, 0, 0.5], [0, 0.5, 0, 0.5], [0, 0, 0.5, 0.5], [0, 0, 0, 1]], float
)  # clip space -1..1 to 0..1
_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenCV camera axes to OpenGL's


def tile_projection(
    tile: Tile, T_world_camera: Float[Array, "4 4"], near: float, far: float
) -> Float[Array, "4 4"]:
    """Clip-from-world matrix of a tile: an off-centre frustum through its border slopes."""
    u0, u1, v0, v1 = tile.slopes
    P = np.zeros((4, 4))
    P[0, 0], P[0, 2] = 2 / (u1 - u0), (u1 + u0) / (u1 - u0)
    P[1, 1], P[1, 2] = 2 / (v1 - v0), -(v1 + v0) / (v1 - v0)
    P[2, 2], P[2, 3], P[3, 2] = (far + near) / (near - far), 2 * far * near / (near - far), -1
    T_world_face = T_world_camera @ geometry.rigid(tile.R_camera_face, np.zeros(3))
    return P @ _OPENGL @ geometry.inverse(T_world_face)


def crop_projection(
    clip: Float[Array, "4 4"], tile: Tile, window: tuple[int, int, int, int]
) -> Float[Array, "4 4"]:
    """Clip-from-world matrix of a window (column, row, width, height in the atlas) of a tile."""
    column, row, width, height = window
    S = np.eye(4)
    S[0, 0], S[1, 1] = tile.width / width, tile.height / height
    S[0, 3] = (tile.width - 2 * (column - tile.column)) / width - 1
    S[1, 3] = (tile.height - 2 * (row - tile.row)) / height - 1
    return S @ clip


def light_projection(
    direction: Float[Array, "3"], focus: Float[Array, "3"], size: int
) -> Float[Array, "4 4"]:
    """Clip-from-world matrix of a distant light over a square around a point.

    The square moves in whole shadow pixels, so that shadows of static objects do not flicker.
    """
    z = -geometry.unit(direction)
    x = geometry.unit(np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z))
    R = np.stack([x, np.cross(z, x), z])  # light axes in rows; looks along -z
    pixel = 2 * SHADOW_HALF_WIDTH / size
    center = np.round(R @ focus / pixel) * pixel
    half, depth = SHADOW_HALF_WIDTH, SHADOW_DEPTH / 2
    clip = np.eye(4)
    clip[:3, :3] = R / np.array([half, half, -depth])[:, None]
    clip[:3, 3] = -center / np.array([half, half, -depth])
    return clip


def ground_depth(clip: Float[Array, "4 4"], size: int) -> Float[Array, "3"]:
    """Depth (0..1) of the floor z = 0 in a shadow map of `size` pixels, drawn through `clip`.

    The depth at a pixel centre is result[0] + result[1] * column + result[2] * row.
    """
    to_world = np.linalg.inv(TO_TEXTURE @ clip)
    right, up, away, origin = to_world[2]  # height over the floor, by texture coordinates and depth
    slope = np.array([right, up]) / size
    at_first = origin + slope.sum() / 2
    return (-np.array([at_first, *slope]) / away).astype(np.float32)


def linear_depth(raw: Float[Array, "*n"], near: float, far: float) -> Float[Array, "*n"]:
    """Metres along the face's z axis from the depth buffer's 0..1."""
    return (near * far / (far - raw.astype(np.float64) * (far - near))).astype(np.float32)


def intersects_frustum(
    clip: Float[Array, "4 4"], low: Float[Array, "C 3"], high: Float[Array, "C 3"]
) -> Bool[Array, "C"]:
    """Which boxes may intersect the frustum; conservative: keeps every visible one."""
    planes = np.concatenate([clip[3] + clip[:2], clip[3] - clip[:2], (clip[3] + clip[2])[None]])
    normal = planes[:, :3]
    # Signed distance of the box corner deepest inside each plane.
    inside = np.maximum(normal, 0) @ high.T + np.minimum(normal, 0) @ low.T + planes[:, 3:]
    return np.all(inside >= 0, axis=0)
