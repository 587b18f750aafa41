"""How open to light each point of a body is at rest: dark in the armpits, between the legs."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from egocap.geometry import unit
from egocap_sim.human.body.triangles import vertex_normals

DIRECTIONS = 96
CELL = 0.012  # m, of the depth maps
CLEAR = 0.02  # m that something must stand before a point to shade it


def openness(
    vertices: Float[Array, "N 3"], faces: Int[Array, "F 3"], samples: int = DIRECTIONS
) -> Float[Array, "N"]:
    """Share (0 to 1) of the light from all around, weighted by cosine, that reaches each vertex.

    Depth maps of the surface from directions spread evenly over the sphere; light from below
    counts for a third.
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
    """Points all over the surface, dense enough to fill the depth maps."""
    steps = [(i / 4, j / 4) for i in range(5) for j in range(5 - i)]
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return np.concatenate([a + s * (b - a) + t * (c - a) for s, t in steps])


def _sphere(count: int) -> Float[Array, "count 3"]:
    """Directions spread evenly (Fibonacci)."""
    i = np.arange(count) + 0.5
    z, turn = 1 - 2 * i / count, np.pi * (1 + np.sqrt(5)) * i
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], 1)
