"""Merge meshes into one vertex buffer and one texture array, for one draw call per cube face.

A batch is one actor or the whole environment. Its triangles are sorted into chunks, contiguous in
the index buffer, each with a bounding box for frustum culling per cube face.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array
from scipy.sparse import csr_array
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.spatial import KDTree

from egocap.errors import InputError
from egocap_sim.assets.mesh import Mesh

OPENING = 0.15  # metres from an open edge within which a double-sided mesh is drawn from both sides
GLOW = 255  # alpha of an emissive texture


@dataclass(frozen=True, eq=False)
class Layer:
    """A texture and its material: alpha is the highlight strength 0 to 200, or `GLOW`."""

    texture: UInt8[Array, "H W 3"]  # sRGB
    alpha: int


@dataclass(frozen=True, eq=False)
class Chunk:
    """A run of triangles that is culled as one.

    The inside of a double-sided mesh (a sleeve, a hem) is visible only near its openings; elsewhere
    its triangles are one-sided, which saves a tenth of the frame time.
    """

    first: int  # first index in the index buffer
    count: int
    casts_shadow: bool
    double_sided: bool


@dataclass(frozen=True, eq=False)
class Batch:
    """Merged meshes in the layout of the graphics memory.

    `blend` maps the stacked rows of all skinning transforms to posed positions, `blend_normals` to
    posed normals; both are None for rigid batches.
    """

    positions: Float[Array, "N 3"]
    normals: Float[Array, "N 3"]
    uv: Float[Array, "N 2"]
    layer_part: Float[Array, "N 2"]  # texture layer plus `_surface_kind`; part label / 255
    faces: Int[Array, "F 3"]
    chunks: tuple[Chunk, ...]
    layers: tuple[Layer, ...]
    order: Int[Array, "N"]  # index of each vertex among the stacked meshes' vertices
    n_bones: int
    blend: csr_array | None
    blend_normals: csr_array | None
    _members: Int[Array, "M"]  # vertices of each chunk, chunk after chunk
    _starts: Int[Array, "C"]

    def pose(self, transforms: Float[Array, "B 4 4"]) -> tuple[Array, Array]:
        """Posed positions and unit normals under an actor's skinning transforms.

        Raises: InputError if the meshes use more bones than there are transforms.
        """
        if self.blend is None or self.blend_normals is None:
            return self.positions, self.normals
        if len(transforms) < self.n_bones:
            raise InputError(
                f"{len(transforms)} skinning transforms for meshes with {self.n_bones} bones",
                valid="one 4x4 transform a bone",
            )
        # The last bone is the world, for rigid meshes of an actor.
        S = np.concatenate([transforms[: self.n_bones], np.eye(4)[None]]).astype(np.float32)
        rows = np.swapaxes(S[:, :3, :], 1, 2)  # (B, 4, 3)
        normals = self.blend_normals @ rows[:, :3].reshape(-1, 3)
        normals /= np.maximum(np.sqrt(np.einsum("ni,ni->n", normals, normals)), 1e-9)[:, None]
        return self.blend @ rows.reshape(-1, 3), normals

    def boxes(self, positions: Float[Array, "N 3"]) -> tuple[Array, Array]:
        """Lower and upper corners (C, 3) of every chunk's bounding box."""
        gathered = positions[self._members]
        return (
            np.minimum.reduceat(gathered, self._starts),
            np.maximum.reduceat(gathered, self._starts),
        )


def merge(meshes: Sequence[Mesh]) -> Batch:
    """Merge meshes into one batch; rigid ones stay in the world."""
    n_bones = max((int(m.bones.max()) + 1 for m in meshes if m.bones is not None), default=0)
    offsets = np.cumsum([0] + [len(m.vertices) for m in meshes])
    positions = np.concatenate([m.vertices for m in meshes]).astype(np.float32)
    faces = np.concatenate([m.faces + o for m, o in zip(meshes, offsets, strict=False)])
    normals = _normals(meshes, faces)
    parts = np.concatenate([np.asarray(m.parts, np.uint8) for m in meshes])
    layers, layer_of_mesh = _layers(meshes)
    layer = np.repeat(layer_of_mesh + [_surface_kind(m) for m in meshes], np.diff(offsets))
    faces, chunks = _chunks(meshes, faces, parts)
    faces, order = _order_for_vertex_cache(faces, chunks, len(positions))
    positions, normals, parts, layer = (a[order] for a in (positions, normals, parts, layer))
    members = [
        np.unique(faces[c.first // 3 : (c.first + c.count) // 3]) for c in chunks
    ]  # fmt: skip
    blend = blend_normals = None
    if n_bones:
        bones, weights = (a[order] for a in _skinning(meshes, n_bones))
        blend = _blend(np.c_[positions, np.ones(len(positions))], bones, weights, n_bones + 1)
        blend_normals = _blend(normals, bones, weights, n_bones + 1)
    return Batch(
        positions=positions,
        normals=normals.astype(np.float32),
        uv=np.concatenate([m.uv for m in meshes]).astype(np.float32)[order],
        layer_part=np.stack([layer, parts / 255.0], -1).astype(np.float32),
        faces=faces,
        chunks=chunks,
        layers=layers,
        order=order,
        n_bones=n_bones,
        blend=blend,
        blend_normals=blend_normals,
        _members=np.concatenate(members),
        _starts=np.cumsum([0] + [len(m) for m in members[:-1]]),
    )


def _surface_kind(mesh: Mesh) -> float:
    """Surface kind for the shader, a fraction added to the texture layer's index."""
    if mesh.name == "skin":
        return 0.3
    return 0.15 if mesh.bones is not None and mesh.shininess == 0.0 else 0.0


def vertex_normals(vertices: Float[Array, "N 3"], faces: Int[Array, "F 3"]) -> Float[Array, "N 3"]:
    """Area-weighted unit normals of a mesh's vertices."""
    a, b, c = (np.asarray(vertices, float)[faces[:, i]] for i in range(3))
    across = np.cross(b - a, c - a)
    normals = np.zeros((len(vertices), 3))
    for i in range(3):
        np.add.at(normals, faces[:, i], across)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.where(length > 0, length, 1.0)


def _normals(meshes: Sequence[Mesh], faces: Int[Array, "F 3"]) -> Float[Array, "N 3"]:
    """Vertex normals: smooth across texture seams of skin and cloth, hard at split rigid edges."""
    welded, n = [], 0
    for m in meshes:
        if m.bones is None:
            welded.append(np.arange(n, n + len(m.vertices)))
        else:
            first, place = _weld(m.vertices, digits=6)
            welded.append(n + first[place])
        n += len(m.vertices)
    welded = np.concatenate(welded)
    return vertex_normals(np.concatenate([m.vertices for m in meshes]), welded[faces])[welded]


def _weld(vertices: Float[Array, "N 3"], digits: int) -> tuple[Int[Array, "P"], Int[Array, "N"]]:
    """Weld vertices equal to `digits` decimals: first vertex of each place, place of each one."""
    grid = np.rint(np.asarray(vertices, float) * 10.0**digits).astype(int)
    order = np.lexsort(grid.T)
    new = np.ones(len(grid), bool)
    new[1:] = (grid[order[1:]] != grid[order[:-1]]).any(axis=1)
    place = np.empty(len(grid), int)
    place[order] = np.cumsum(new) - 1
    return order[new], place


def _chunks(meshes: Sequence[Mesh], faces: Array, parts: Array) -> tuple[Array, tuple[Chunk, ...]]:
    """Sort triangles by sidedness, shadow casting, mesh (rigid: small first) and part into runs.

    Small meshes mostly occlude large ones, so that drawing them first saves shading.
    """
    small_first = np.argsort(np.argsort([np.ptp(m.vertices, axis=0).max() for m in meshes]))
    mesh_of_face = np.repeat(np.arange(len(meshes)), [len(m.faces) for m in meshes])
    rules = np.array(
        [
            (not m.casts_shadow, -1 if m.bones is not None else small_first[i])
            for i, m in enumerate(meshes)
        ]
    )[mesh_of_face]
    two_sided = np.concatenate([_near_opening(m) for m in meshes])
    keys = np.c_[two_sided, rules, parts[faces[:, 2]]]
    order = np.lexsort(keys.T[::-1])
    keys, faces = keys[order], faces[order]
    cuts = np.flatnonzero(np.any(np.diff(keys, axis=0) != 0, axis=1)) + 1
    edges = [0, *cuts.tolist(), len(faces)]
    return faces, tuple(
        Chunk(3 * a, 3 * (b - a), not keys[a, 1], bool(keys[a, 0])) for a, b in pairwise(edges)
    )


def _order_for_vertex_cache(faces: Array, chunks: Sequence[Chunk], n: int) -> tuple[Array, Array]:
    """Reorder faces and vertices for the vertex cache; also returns the vertices' old indices.

    This saves a quarter of the vertex shading.
    """
    along = csr_array((np.ones(faces.size), (faces.ravel(), faces[:, [1, 2, 0]].ravel())), (n, n))
    rank = np.empty(n, int)
    rank[reverse_cuthill_mckee(along + along.T, symmetric_mode=True)] = np.arange(n)
    chunk = np.repeat(np.arange(len(chunks)), [c.count // 3 for c in chunks])
    faces = faces[np.lexsort((rank[faces].min(axis=1), chunk))]
    used, first = np.unique(faces, return_index=True)
    unused = np.setdiff1d(np.arange(n), used)
    order = np.concatenate([used[np.argsort(first)], unused])
    new = np.empty(n, int)
    new[order] = np.arange(n)
    return new[faces], order


def _near_opening(mesh: Mesh) -> Bool[Array, "F"]:
    """Triangles near an open edge of a double-sided mesh, whose back may be visible."""
    if not mesh.double_sided:
        return np.zeros(len(mesh.faces), bool)
    first, place = _weld(mesh.vertices, digits=5)
    faces = place[mesh.faces]
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges, times = np.unique(edges.min(1) * len(first) + edges.max(1), return_counts=True)
    rim = np.unique(np.divmod(edges[times == 1], len(first)))
    if not len(rim):
        return np.zeros(len(mesh.faces), bool)
    at = mesh.vertices[first]
    distance, _ = KDTree(at[rim]).query(at)
    return (distance[faces] < OPENING).any(axis=1)


def _layers(meshes: Sequence[Mesh]) -> tuple[tuple[Layer, ...], Int[Array, "M"]]:
    """The distinct textures, and the index of each mesh's texture."""
    index: dict[tuple[int | bytes, int], int] = {}
    of_mesh, layers = [], []
    for m in meshes:
        alpha = GLOW if m.glows else round(200 * min(max(m.shininess, 0.0), 1.0))
        small = m.texture.size < 256  # a uniform colour, shared by many meshes
        key = (m.texture.tobytes() if small else id(m.texture), alpha)
        if key not in index:
            index[key] = len(layers)
            layers.append(Layer(np.asarray(m.texture, np.uint8), alpha))
        of_mesh.append(index[key])
    return tuple(layers), np.array(of_mesh)


def _skinning(meshes: Sequence[Mesh], world_bone: int) -> tuple[Array, Array]:
    bones, weights = [], []
    for m in meshes:
        n = len(m.vertices)
        if m.bones is None or m.weights is None:
            bones.append(np.full((n, 4), world_bone))
            weights.append(np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)))
        else:
            bones.append(m.bones)
            weights.append(m.weights)
    return np.concatenate(bones), np.concatenate(weights)


def _blend(values: Array, bones: Array, weights: Array, n_bones: int) -> csr_array:
    """Matrix (N, K n_bones) that maps stacked transform rows to blended values."""
    n, k = values.shape
    data = weights[:, :, None] * values[:, None, :]  # (N, 4, K)
    column = bones[:, :, None] * k + np.arange(k)
    row = np.repeat(np.arange(n), 4 * k)
    matrix = csr_array(
        (data.ravel().astype(np.float32), (row, column.ravel())), shape=(n, k * n_bones)
    )
    matrix.sum_duplicates()
    matrix.eliminate_zeros()
    return matrix
