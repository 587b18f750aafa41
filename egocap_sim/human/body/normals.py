"""Normals of a surface's vertices."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from egocap.geometry import unit


def vertex_normals(vertices: Float[Array, "N 3"], faces: Int[Array, "F 3"]) -> Float[Array, "N 3"]:
    """Unit normals of the vertices, weighted by the areas around them."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    face = np.cross(b - a, c - a)
    corner, n = faces.T.ravel(), len(vertices)
    normal = [np.bincount(corner, np.tile(face[:, k], 3), minlength=n) for k in range(3)]
    return unit(np.stack(normal, 1))
