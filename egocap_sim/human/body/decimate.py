"""Mesh decimation by half-edge collapses, for regions with more detail than a camera resolves.

Vertices are removed but never moved, so blend shapes, skin weights and texture coordinates of the
remaining ones stay valid.

Source: Garland and Heckbert, "Surface Simplification Using Quadric Error Metrics", 1997, with
half-edge collapses.
"""

from __future__ import annotations

import heapq

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from egocap.geometry import unit
from egocap_sim.human.body.triangles import edge_counts

FLIPPED = 0.2  # least cosine between a triangle's normals before and after a collapse
COMPACT = 2e-3  # weight of an edge's squared length: prefers compact triangles on flat surfaces


def decimate(
    vertices: Float[Array, "N 3"],
    faces: Int[Array, "F 3"],
    face_uv: Int[Array, "F 3"],
    removable: Bool[Array, "N"],
    count: int,
) -> tuple[Int[Array, "G 3"], Int[Array, "G 3"], Int[Array, "G"]]:
    """Remove up to `count` triangles by collapsing `removable` vertices.

    Vertices on open edges and on texture seams are kept. Returns the triangles, their texture
    corners, and their row in `faces`.
    """
    mesh, n = _Mesh(vertices, faces, face_uv), len(vertices)
    removable = removable & ~_on_border(faces, n) & ~_on_seam(faces, face_uv, n)
    heap = [entry for u in np.flatnonzero(removable) for entry in mesh.candidates(int(u))]
    heapq.heapify(heap)
    gone = 0
    while heap and gone < count:
        _, u, v, stamp = heapq.heappop(heap)
        if stamp != mesh.stamp[u] or not mesh.may_collapse(u, v):
            continue
        around = mesh.collapse(u, v)
        gone += 2
        for w in around:
            if removable[w] and mesh.faces_at[w]:
                for entry in mesh.candidates(w):
                    heapq.heappush(heap, entry)
    kept = np.array(sorted(mesh.alive))
    return mesh.faces[kept], mesh.face_uv[kept], kept


class _Mesh:
    """Triangles under collapse: adjacency, and the error quadric of every vertex."""

    def __init__(self, vertices: Array, faces: Array, face_uv: Array) -> None:
        self.points = [np.append(p, 1.0) for p in vertices]
        self.faces, self.face_uv = faces.copy(), face_uv.copy()
        self.alive = set(range(len(faces)))
        self.faces_at: list[set[int]] = [set() for _ in vertices]
        for i, face in enumerate(faces.tolist()):
            for v in face:
                self.faces_at[v].add(i)
        self.stamp = [0] * len(vertices)
        a, b, c = (vertices[faces[:, i]] for i in range(3))
        normal = np.cross(b - a, c - a)
        area = np.linalg.norm(normal, axis=1)
        plane = np.column_stack([unit(normal), -np.einsum("ij,ij->i", unit(normal), a)])
        quadric = area[:, None, None] * plane[:, :, None] * plane[:, None, :]
        self.quadric = np.zeros((len(vertices), 4, 4))
        for i in range(3):
            np.add.at(self.quadric, faces[:, i], quadric)

    def around(self, u: int) -> set[int]:
        return {int(v) for f in self.faces_at[u] for v in self.faces[f]} - {u}

    def candidates(self, u: int) -> list[tuple[float, int, int, int]]:
        """Heap entries (cost, u, v, stamp) of the collapses of u onto each neighbour v."""
        self.stamp[u] += 1
        entries = []
        for v in sorted(self.around(u)):
            p = self.points[v]
            total = self.quadric[u] + self.quadric[v]
            length = self.points[u] - p
            area = total[0, 0] + total[1, 1] + total[2, 2]  # the planes' normals are unit vectors
            cost = float(p @ total @ p) + COMPACT * float(length @ length) * area
            entries.append((cost, u, v, self.stamp[u]))
        return entries

    def may_collapse(self, u: int, v: int) -> bool:
        """Whether the mesh stays manifold and no triangle flips."""
        if not self.faces_at[u] or not self.faces_at[v]:
            return False
        shared = self.faces_at[u] & self.faces_at[v]
        if len(shared) != 2 or len(self.around(u) & self.around(v)) != 2:
            return False
        for f in self.faces_at[u] - shared:
            before = [self.points[w][:3] for w in self.faces[f]]
            after = [self.points[v if w == u else w][:3] for w in self.faces[f]]
            n, m = (np.cross(q[1] - q[0], q[2] - q[0]) for q in (before, after))
            if n @ m < FLIPPED * np.sqrt((n @ n) * (m @ m)) or m @ m == 0:
                return False
        return True

    def collapse(self, u: int, v: int) -> set[int]:
        """Replace u by v; return the former neighbours of u."""
        around = self.around(u)
        shared = self.faces_at[u] & self.faces_at[v]
        any_shared = next(iter(shared))
        uv = self.face_uv[any_shared][list(self.faces[any_shared]).index(v)]
        for f in self.faces_at[u] - shared:
            corner = list(self.faces[f]).index(u)
            self.faces[f, corner], self.face_uv[f, corner] = v, uv
            self.faces_at[v].add(f)
        for f in shared:
            self.alive.discard(f)
            for w in self.faces[f]:
                self.faces_at[w].discard(f)
        self.faces_at[u] = set()
        self.stamp[u] += 1
        self.quadric[v] += self.quadric[u]
        return around


def _on_border(faces: Array, n: int) -> Bool[Array, "N"]:
    """Vertices of edges that do not have exactly two triangles."""
    edges, count = edge_counts(faces)
    mask = np.zeros(n, bool)
    mask[edges[count != 2]] = True
    return mask


def _on_seam(faces: Array, face_uv: Array, n: int) -> Bool[Array, "N"]:
    """Vertices with more than one texture coordinate."""
    pairs = np.unique(np.stack([faces.ravel(), face_uv.ravel()], 1), axis=0)
    return np.bincount(pairs[:, 0], minlength=n) > 1
