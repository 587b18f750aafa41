"""Coarser copies of meshes, for distant objects.

Source: J. Rossignac and P. Borrel, Multi-resolution 3D approximations for rendering complex scenes
(1993): vertices in one cell of a grid become one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from egocap_sim.assets.mesh import Mesh


def simplify(mesh: Mesh, cell_m: float) -> Mesh:
    """Merge the vertices of a mesh within grid cells of `cell_m` metres; seams stay closed.

    Only vertices with the same main bone are merged, so limbs stay apart. The two sides of a
    texture seam keep their own texture coordinates at a common position.
    """
    welded = np.round(mesh.vertices, 6)  # the two sides of a seam may differ in the last bit
    spot = _grouped(np.c_[np.floor(welded / cell_m).astype(int), _owner(mesh)])
    corner = _grouped(np.c_[spot, _charts(mesh)])
    position = _means(mesh.vertices, spot)
    first = np.unique(corner, return_index=True)[1]
    faces = corner[mesh.faces]
    a, b, c = spot[mesh.faces].T
    faces = faces[(a != b) & (b != c) & (c != a)]
    return replace(
        mesh,
        vertices=position[spot[first]],
        faces=faces,
        uv=_means(mesh.uv, corner),
        parts=mesh.parts[first],
        bones=None if mesh.bones is None else mesh.bones[first],
        weights=None if mesh.weights is None else mesh.weights[first],
    )


def _owner(mesh: Mesh) -> Int[Array, "N"]:
    if mesh.bones is None or mesh.weights is None:
        return np.zeros(len(mesh.vertices), int)
    most = mesh.weights.argmax(1)
    return mesh.bones[np.arange(len(most)), most]


def _charts(mesh: Mesh) -> Int[Array, "N"]:
    """Connected component of the mesh, hence texture chart, of each vertex."""
    i, j = mesh.faces[:, [0, 1, 2]].ravel(), mesh.faces[:, [1, 2, 0]].ravel()
    n = len(mesh.vertices)
    return connected_components(csr_array((np.ones(len(i)), (i, j)), (n, n)), directed=False)[1]


def _grouped(keys: Int[Array, "N K"]) -> Int[Array, "N"]:
    """Rank of each row among the distinct rows."""
    low = keys.min(0)
    spread = keys.max(0) - low + 1
    assert np.prod(spread, dtype=float) < 2**63, spread
    single = np.ravel_multi_index(tuple((keys - low).T), tuple(spread))
    return np.unique(single, return_inverse=True)[1]


def _means(values: Float[Array, "N D"], group: Int[Array, "N"]) -> Float[Array, "G D"]:
    count = np.bincount(group)
    sums = [np.bincount(group, values[:, k]) for k in range(values.shape[1])]
    return np.stack(sums, -1) / count[:, None]
