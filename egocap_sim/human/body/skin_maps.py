"""Maps of occlusion, redness and nails in the layout of the skin's texture.

Computed once from the undecimated mesh and stored in the cache file of `anny_source`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Shaped, UInt8
from numpy import ndarray as Array
from scipy.interpolate import LinearNDInterpolator

from egocap.geometry import unit
from egocap_sim.human.body.triangles import vertex_normals

SIZE = 512  # px
OPEN, RED, NAIL = range(3)  # channels
DIRECTIONS = 96
CELL = 0.012  # m, pixel of the depth maps for ambient occlusion
CLEAR = 0.02  # m, least distance of an occluder from the point that it shades


class Surface(NamedTuple):
    """A triangle mesh with its own triangles in the texture."""

    vertices: Float[Array, "N 3"]
    faces: Int[Array, "F 3"]
    uv: Float[Array, "U 2"]
    face_uv: Int[Array, "F 3"]


def skin_maps(
    surface: Surface,
    light: Float[Array, "N"],
    bone: Shaped[Array, "N"],
    at: Mapping[str, Float[Array, "3"]],
) -> UInt8[Array, "512 512 3"]:
    """Shares from 0 to 255: openness to `light`, redness (joints, cheeks, nose), finger nails.

    `bone` is the name of the bone with the largest weight; `at` are the bones' heads.
    """
    vertices, faces, uv, face_uv = surface
    normals = vertex_normals(vertices, faces)
    red, nail = np.zeros(len(vertices)), np.zeros(len(vertices))

    def near(point: Array, radius: float) -> Array:
        return np.exp(-0.5 * (np.linalg.norm(vertices - point, axis=1) / radius) ** 2)

    for side in "LR":
        for joint, radius in (("lowerarm01", 0.03), ("lowerleg01", 0.045), ("foot", 0.03)):
            red = np.maximum(red, 0.6 * near(at[f"{joint}.{side}"], radius))
        for finger in range(1, 6):
            chain = [at[f"finger{finger}-{k}.{side}"] for k in (1, 2, 3)]
            for joint in chain:
                red = np.maximum(red, 0.8 * near(joint, 0.009))
            mine = bone == f"finger{finger}-3.{side}"
            nail = np.maximum(nail, _nail(vertices, normals, mine, *chain))
    face = (vertices[:, 2] > at["head"][2]) & (normals[:, 0] > 0.2)
    tip = vertices[np.argmax(np.where(face, vertices[:, 0], -np.inf))]
    red = np.maximum(red, 0.8 * near(tip, 0.012) * face)
    for y in (0.035, -0.035):
        red = np.maximum(red, 0.5 * near(tip + [-0.025, y, 0.005], 0.018) * face)
    pairs = np.unique(np.stack([face_uv.ravel(), faces.ravel()], 1), axis=0)
    place, vertex = uv[pairs[:, 0]], pairs[:, 1]
    values = np.stack([light, red, nail], 1)[vertex]
    centre = (np.arange(SIZE) + 0.5) / SIZE
    grid = np.stack(np.meshgrid(centre, centre), -1).reshape(-1, 2)
    picture = LinearNDInterpolator(place, values, fill_value=0.5)(grid).reshape(SIZE, SIZE, 3)
    return np.rint(255 * np.clip(picture, 0, 1)).astype(np.uint8)


def _nail(
    vertices: Array, normals: Array, mine: Array, first: Array, second: Array, third: Array
) -> Float[Array, "N"]:
    """1 on the nail: the outer part of the last phalanx, on the side away from the bend."""
    if not mine.any():
        return np.zeros(len(vertices))
    along = unit(third - second)
    back = unit(unit(second - first) - along)
    back = unit(back - (back @ along) * along)
    reach = (vertices - third) @ along
    length = reach[mine].max()
    inside = np.clip((reach / length - 0.42) / 0.1, 0, 1)
    upward = np.clip((normals @ back - 0.5) / 0.2, 0, 1)
    return np.where(mine, inside * upward, 0.0)


def openness(
    vertices: Float[Array, "N 3"], faces: Int[Array, "F 3"], samples: int = DIRECTIONS
) -> Float[Array, "N"]:
    """Ambient occlusion: cosine-weighted share (0 to 1) of light that reaches each vertex.

    Uses depth maps from directions spread evenly over the sphere; light from below counts for a
    third.
    """
    normals = vertex_normals(vertices, faces)
    points = _spread(vertices, faces)
    total, reached = np.zeros(len(vertices)), np.zeros(len(vertices))
    for direction in _sphere(samples):
        across = unit(np.cross(direction, [0.31, 0.77, 0.56]))
        frame = np.stack([across, np.cross(direction, across), direction], 1)
        column, row, depth = _cells(points @ frame)
        size = np.array([column.max(), row.max()]) + 3
        nearest = np.full(size, -np.inf)
        np.maximum.at(nearest, (column, row), depth)
        column, row, depth = _cells(vertices @ frame, points @ frame)
        before = nearest[np.clip(column, 0, size[0] - 1), np.clip(row, 0, size[1] - 1)]
        weight = np.maximum(normals @ direction, 0) * (1.0 if direction[2] > 0 else 1 / 3)
        total += weight
        reached += weight * (before < depth + CLEAR)
    return reached / np.maximum(total, 1e-9)


def _cells(points: Array, origin: Array | None = None) -> tuple[Array, Array, Array]:
    low = (points if origin is None else origin)[:, :2].min(0)
    column, row = np.floor((points[:, :2] - low) / CELL).astype(int).T + 1
    return column, row, points[:, 2]


def _spread(vertices: Array, faces: Array) -> Array:
    """Sample points on the surface, dense enough to fill the depth maps."""
    steps = [(i / 4, j / 4) for i in range(5) for j in range(5 - i)]
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return np.concatenate([a + s * (b - a) + t * (c - a) for s, t in steps])


def _sphere(count: int) -> Float[Array, "count 3"]:
    """Directions spread evenly (Fibonacci)."""
    i = np.arange(count) + 0.5
    z, turn = 1 - 2 * i / count, np.pi * (1 + np.sqrt(5)) * i
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], 1)
