"""Triangle surfaces: vertex normals, edges, faces between rings, numbering."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from egocap.geometry import unit
from egocap_sim.assets.primitives import grid_faces


def vertex_normals(vertices: Float[Array, "N 3"], faces: Int[Array, "F 3"]) -> Float[Array, "N 3"]:
    """Unit vertex normals, weighted by the areas of adjacent triangles."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    face = np.cross(b - a, c - a)
    corner, n = faces.T.ravel(), len(vertices)
    normal = [np.bincount(corner, np.tile(face[:, k], 3), minlength=n) for k in range(3)]
    return unit(np.stack(normal, 1))


def edge_counts(faces: Int[Array, "F 3"]) -> tuple[Int[Array, "3*F 2"], Int[Array, "3*F"]]:
    """Directed edges of all triangles, and how many triangles share each one, in any direction."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    key = np.minimum(*edges.T) * (faces.max(initial=0) + 1) + np.maximum(*edges.T)
    _, index, count = np.unique(key, return_inverse=True, return_counts=True)
    return edges, count[index]


def ring_faces(rings: int, around: int) -> Int[Array, "F 3"]:
    """Triangles between rings of `around` + 1 points, the last of which equals the first."""
    faces = grid_faces(rings - 1, around).reshape(2, rings - 1, around, 3)
    return faces.swapaxes(0, 1).reshape(-1, 3).astype(np.int32)


def distinct(numbers: Int[Array, "N"]) -> tuple[Int[Array, "M"], Int[Array, "N"]]:
    """First index of each distinct number, in order, and the rank of every entry's number.

    Like `numpy.unique` but without sorting; memory grows with the largest number.
    """
    first = np.full(numbers.max(initial=-1) + 1, -1)
    first[numbers[::-1]] = np.arange(len(numbers))[::-1]
    met = first >= 0
    return first[met], (np.cumsum(met) - 1)[numbers]
