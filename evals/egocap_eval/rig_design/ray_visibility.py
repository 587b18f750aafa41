"""Visibility of a simulated person's joints from camera places, by rays cast at the body surface.

The rule is the renderer's (`truth.visibility`): a joint is visible when enough of the skin around
it is. Nothing is rendered, and the surface is coarser, so that a sweep of rigs takes seconds.
Occlusion depends on a camera's place, not on its direction or lens: rigs with cameras in the same
places share the work. `egocap-eval rig --check` compares the two.

Source: Moeller & Trumbore 1997, "Fast, minimum storage ray-triangle intersection".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numba import njit, prange
from numpy import ndarray as Array

from egocap.body.labels import LABELS
from egocap.geometry import rigid
from egocap_sim.assets.mesh_simplify import simplify
from egocap_sim.human.body.person import Person
from egocap_sim.truth.visibility import CLOTH_M, SHARE, SkinPoints, parts_around

CELL_M = 0.025
"""Grid cell whose vertices are merged."""
CLUSTER_M = 0.12
"""Edge of the cells whose triangles share a bounding sphere."""


class Surface(NamedTuple):
    """Skinned triangles, sorted into clusters with bounding spheres."""

    vertices: Float[Array, "N 3"]  # at rest, metres
    bones: Int[Array, "N 4"]
    weights: Float[Array, "N 4"]
    faces: Int[Array, "F 3"]
    parts: Int[Array, "F"]  # label of `egocap_sim.core.part_labels`
    starts: Int[Array, "C"]  # first face of each cluster, and the number of faces at the end


class RayVisibility:
    """Visibility of the joints of one simulated person, in any pose, from any place."""

    def __init__(self, person: Person, cell_m: float = CELL_M) -> None:
        self._surface = make_surface(person, cell_m)
        self._rest = rigid(np.eye(3), -person.joints)
        self._points = SkinPoints.around_joints(person)

    def shares(
        self, T_head_body: Float[Array, "T 21 4 4"], eyes: Float[Array, "U 3"]
    ) -> Float[Array, "T U 18"]:
        """Share of the skin about each joint that shows to eyes, in the head frame, metres."""
        bodies = np.ascontiguousarray(T_head_body, float)
        out = np.empty((len(bodies), len(eyes), len(LABELS)))
        _shares(
            self._surface, bodies, bodies @ self._rest, self._points.body, self._points.offset,
            parts_around(), np.ascontiguousarray(eyes, float), CLOTH_M, out,
        )  # fmt: skip
        return out

    def shown(
        self, T_head_body: Float[Array, "T 21 4 4"], eyes: Float[Array, "U 3"]
    ) -> Bool[Array, "T U 18"]:
        """Whether the joints are unoccluded from eyes, whatever the lens."""
        return self.shares(T_head_body, eyes) >= SHARE


def make_surface(person: Person, cell_m: float) -> Surface:
    """The rendered meshes of a person, simplified to cells of `cell_m` metres."""
    meshes = [simplify(mesh, cell_m) for mesh in person.actor.meshes]
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    vertices = np.concatenate([mesh.vertices for mesh in meshes]).astype(float)
    carried = [
        (m.bones, m.weights) for m in meshes if m.bones is not None and m.weights is not None
    ]
    assert len(carried) == len(meshes), "a person's meshes are skinned"
    bones = np.concatenate([bones for bones, _ in carried]).astype(np.int64)
    weights = np.concatenate([weights for _, weights in carried]).astype(float)
    faces = np.concatenate([m.faces + f for m, f in zip(meshes, first[:-1], strict=True)])
    parts = np.concatenate([mesh.parts for mesh in meshes]).astype(np.int64)[faces[:, 0]]
    most = bones[np.arange(len(bones)), weights.argmax(1)][faces[:, 0]]
    cell = np.floor(vertices[faces].mean(1) / CLUSTER_M).astype(np.int64)
    _, cluster = np.unique(np.c_[most, cell], axis=0, return_inverse=True)
    order = np.argsort(cluster.reshape(-1), kind="stable")
    counts = np.bincount(cluster.reshape(-1))
    starts = np.concatenate([[0], np.cumsum(counts)])
    return Surface(vertices, bones, weights, faces[order].astype(np.int64), parts[order], starts)


@njit(cache=True, parallel=True)
def _shares(surface, bodies, skinning, owner, offset, around, eyes, cloth, out):
    for t in prange(len(bodies)):
        posed = np.empty((len(surface.vertices), 3))
        _pose(surface, skinning[t], posed)
        spheres = np.empty((len(surface.starts) - 1, 4))
        _bound(surface, posed, spheres)
        labels, samples = owner.shape
        point = np.empty(3)
        for label in range(labels):
            out[t, :, label] = 0.0
            for s in range(samples):
                T = bodies[t, owner[label, s]]
                for r in range(3):
                    point[r] = T[r, 3]
                    for c in range(3):
                        point[r] += T[r, c] * offset[label, s, c]
                for u in range(len(eyes)):
                    if _shows(surface, posed, spheres, eyes[u], point, around[label], cloth):
                        out[t, u, label] += 1.0 / samples


@njit(cache=True)
def _pose(surface, S, posed):
    for n in range(len(posed)):
        x, y, z = surface.vertices[n, 0], surface.vertices[n, 1], surface.vertices[n, 2]
        for r in range(3):
            total = 0.0
            for k in range(surface.bones.shape[1]):
                w = surface.weights[n, k]
                if w > 0.0:
                    M = S[surface.bones[n, k]]
                    total += w * (M[r, 0] * x + M[r, 1] * y + M[r, 2] * z + M[r, 3])
            posed[n, r] = total


@njit(cache=True)
def _bound(surface, posed, spheres):
    """Centre and radius of a sphere about every cluster."""
    for q in range(len(spheres)):
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for f in range(surface.starts[q], surface.starts[q + 1]):
            for c in range(3):
                for r in range(3):
                    value = posed[surface.faces[f, c], r]
                    low[r], high[r] = min(low[r], value), max(high[r], value)
        squared = 0.0
        for r in range(3):
            spheres[q, r] = 0.5 * (low[r] + high[r])
            squared += 0.25 * (high[r] - low[r]) ** 2
        spheres[q, 3] = np.sqrt(squared)


@njit(cache=True)
def _shows(surface, posed, spheres, eye, point, own, cloth):
    """Whether the first surface towards a point of skin belongs to it and is at most `cloth` in
    front. Surfaces behind the point do not count: the coarse mesh may miss a slim limb."""
    dx, dy, dz = point[0] - eye[0], point[1] - eye[1], point[2] - eye[2]
    length = np.sqrt(dx * dx + dy * dy + dz * dz)
    dx, dy, dz = dx / length, dy / length, dz / length
    nearest, mine = length + cloth, True
    for q in range(len(spheres)):
        ax, ay, az = spheres[q, 0] - eye[0], spheres[q, 1] - eye[1], spheres[q, 2] - eye[2]
        along, radius = ax * dx + ay * dy + az * dz, spheres[q, 3]
        if along + radius < 0.0 or along - radius > nearest:
            continue
        if ax * ax + ay * ay + az * az - along * along > radius * radius:
            continue
        for f in range(surface.starts[q], surface.starts[q + 1]):
            far = _meets(posed, surface.faces[f], eye, dx, dy, dz)
            if far < nearest:
                if far < length - cloth:
                    return False
                nearest, mine = far, own[surface.parts[f]]
    return mine


@njit(cache=True)
def _meets(posed, face, eye, dx, dy, dz):
    """Distance along a unit ray to a triangle, seen from either side; infinite where it misses."""
    a, b, c = posed[face[0]], posed[face[1]], posed[face[2]]
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    px, py, pz = dy * vz - dz * vy, dz * vx - dx * vz, dx * vy - dy * vx
    volume = ux * px + uy * py + uz * pz
    if abs(volume) < 1e-15:
        return np.inf
    sx, sy, sz = eye[0] - a[0], eye[1] - a[1], eye[2] - a[2]
    first = (sx * px + sy * py + sz * pz) / volume
    if first < 0.0 or first > 1.0:
        return np.inf
    qx, qy, qz = sy * uz - sz * uy, sz * ux - sx * uz, sx * uy - sy * ux
    second = (dx * qx + dy * qy + dz * qz) / volume
    if second < 0.0 or first + second > 1.0:
        return np.inf
    far = (vx * qx + vy * qy + vz * qz) / volume
    return far if far > 1e-4 else np.inf
