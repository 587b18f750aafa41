"""Joint visibility by rays cast in MuJoCo: an independent check of the renderer's.

The surfaces are posed here without the renderer's code and intersected by `mju_raySkin`. The rule
is that of `truth.visibility` over five times as many points of skin, so that the two differ only
where a joint is partly hidden.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array

from egocap.body.labels import LABELS
from egocap.cameras.rig import Rig
from egocap.data.sequence import OCCLUDED, OUT_OF_VIEW, SELF_OCCLUDED, VISIBLE
from egocap.geometry import inverse, transform
from egocap_sim.assets.mesh import Actor, Mesh
from egocap_sim.core.bodies import INDEX
from egocap_sim.core.part_labels import BACKGROUND, RIG, WEARER_FIRST, WEARER_LAST
from egocap_sim.human.body.person import Person
from egocap_sim.truth.visibility import CLOTH_M, PATCH, SHARE, parts_around, patch_around

EVERY = 2  # one in so many vertices of a patch is tested
BORDER = 0.12  # a share of visible points this near to the threshold depends on the sampling


class Surfaces:
    """All drawn triangles, for ray casting."""

    def __init__(self, actors: Sequence[Actor], still: Sequence[Mesh] = ()) -> None:
        self._actors = actors
        meshes = [mesh for actor in actors for mesh in actor.meshes] + list(still)
        starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
        faces = [mesh.faces + start for mesh, start in zip(meshes, starts[:-1], strict=True)]
        self._faces = np.ascontiguousarray(np.concatenate(faces), np.int32)
        self._parts = np.concatenate([mesh.parts for mesh in meshes]).astype(int)
        self._vertices = np.concatenate([mesh.vertices for mesh in meshes]).astype(np.float32)

    def pose(self, skinning: Mapping[str, Float[Array, "B 4 4"]]) -> None:
        """Move the actors' vertices: v' = sum_k w_k S[b_k] v. Rigid ones stay."""
        first = 0
        for actor in self._actors:
            for mesh in actor.meshes:
                if mesh.bones is not None and mesh.weights is not None:
                    S = np.einsum("nk,nkij->nij", mesh.weights, skinning[actor.name][mesh.bones])
                    moved = np.einsum("nij,nj->ni", S[:, :3, :3], mesh.vertices) + S[:, :3, 3]
                    self._vertices[first : first + len(moved)] = moved
                first += len(mesh.vertices)

    def hit(
        self, origin: Float[Array, "3"], rays: Float[Array, "N 3"]
    ) -> tuple[Float[Array, "N"], Int[Array, "N"]]:
        """Distance (m, infinite for none) and part label of the first surface on each unit ray."""
        from mujoco import mju_raySkin  # pyright: ignore[reportAttributeAccessIssue]

        faces, vertices = self._faces.ravel(), self._vertices.ravel()
        distance, part = np.full(len(rays), np.inf), np.full(len(rays), BACKGROUND)
        nearest = np.zeros((1, 1), np.int32)
        for i, ray in enumerate(rays):
            far = mju_raySkin(
                len(self._faces), len(self._vertices), faces, vertices, origin, ray, nearest
            )
            if far >= 0:
                distance[i], part[i] = far, self._parts[nearest[0, 0]]
        return distance, part


@dataclass(frozen=True, eq=False)
class RayResult:
    """Visibility of the joints in one frame, by rays."""

    visibility: UInt8[Array, "V 18"]
    share: Float[Array, "V 18"]  # of the points around each joint that are visible


class RayVisibility:
    """Computes the visibility of one person's joints by rays."""

    def __init__(self, person: Person, rig: Rig, surfaces: Surfaces) -> None:
        self._rig, self._surfaces = rig, surfaces
        chosen = np.array([patch_around(person, label)[:PATCH:EVERY] for label in LABELS])
        self._body = person.body_owner[chosen].astype(int)  # (18, S)
        self._offset = person.body_vertices[chosen] - person.joints[self._body]

    def at(
        self,
        T_world_body: Float[Array, "21 4 4"],
        skinning: Mapping[str, Float[Array, "B 4 4"]],
        in_view: Bool[Array, "V 18"],
    ) -> RayResult:
        """Visibility at one instant; `in_view`: joints inside lens and image."""
        self._surfaces.pose(skinning)
        skin = transform(T_world_body[self._body], self._offset[..., None, :])[..., 0, :]
        visibility = np.full(in_view.shape, OUT_OF_VIEW, np.uint8)
        share = np.zeros(in_view.shape)
        for v, mount in enumerate(self._rig.mounts):
            T_world_camera = T_world_body[INDEX["head"]] @ mount.T_head_camera
            inside = mount.camera.project(transform(inverse(T_world_camera), skin))[1]
            for j in np.flatnonzero(in_view[v]):
                away = skin[j] - T_world_camera[:3, 3]
                depth = np.linalg.norm(away, axis=-1)
                surface, part = self._surfaces.hit(T_world_camera[:3, 3], away / depth[:, None])
                own = parts_around()[j, part] | (part == BACKGROUND)
                shows = inside[j] & (depth <= surface + CLOTH_M) & own
                mine = (part >= WEARER_FIRST) & (part <= WEARER_LAST) | (part == RIG)
                hidden = ~shows & inside[j]
                by_others = (hidden & ~mine).sum() > (hidden & mine).sum()
                share[v, j] = shows.mean()
                if share[v, j] >= SHARE:
                    visibility[v, j] = VISIBLE
                else:
                    visibility[v, j] = OCCLUDED if by_others else SELF_OCCLUDED
        return RayResult(visibility, share)
