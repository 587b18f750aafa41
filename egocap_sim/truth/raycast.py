"""Joint visibility by rays cast in MuJoCo: an independent check of the renderer's.

This module poses the surfaces without the renderer's code and intersects them by `mju_raySkin`. It
applies the rule of `truth.visibility` to five times as many points of skin, so that the two results
differ only for partly hidden joints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array

from egocap.cameras.rig import Rig
from egocap.data.truth import OUT_OF_VIEW
from egocap.geometry import inverse, transform
from egocap_sim.assets.mesh import Actor, Mesh
from egocap_sim.core.bodies import INDEX
from egocap_sim.core.part_labels import BACKGROUND
from egocap_sim.human.body.person import Person
from egocap_sim.truth.visibility import CLOTH_M, SkinPoints, classify, parts_around

EVERY = 2  # one in so many vertices of a patch is tested
BORDER = 0.12  # a visible share closer to the threshold than this depends on the sampling


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
        """Move the actors' vertices: v' = sum_k w_k S[b_k] v. Meshes without bones stay."""
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


class RayVisibility:
    """Computes the visibility of one person's joints by rays."""

    def __init__(self, person: Person, rig: Rig, surfaces: Surfaces) -> None:
        self._rig, self._surfaces = rig, surfaces
        self._points = SkinPoints.around_joints(person, EVERY)

    def at(
        self,
        T_world_body: Float[Array, "21 4 4"],
        skinning: Mapping[str, Float[Array, "B 4 4"]],
        in_view: Bool[Array, "V 18"],
    ) -> tuple[UInt8[Array, "V 18"], Float[Array, "V 18"]]:
        """Visibility at one instant, and the share of the points around each joint that show.

        `in_view`: joints inside lens and image. The share is 0 outside the view.
        """
        self._surfaces.pose(skinning)
        points = self._points.pose(T_world_body)
        visibility = np.full(in_view.shape, OUT_OF_VIEW, np.uint8)
        share = np.zeros(in_view.shape)
        for v, mount in enumerate(self._rig.mounts):
            wanted = in_view[v]
            T_world_camera = T_world_body[INDEX["head"]] @ mount.T_head_camera
            skin = points[wanted]
            inside = mount.camera.project(transform(inverse(T_world_camera), skin))[1]
            away = skin - T_world_camera[:3, 3]
            depth = np.linalg.norm(away, axis=-1)
            rays = (away / depth[..., None]).reshape(-1, 3)
            hits = self._surfaces.hit(T_world_camera[:3, 3], rays)
            surface, part = (a.reshape(depth.shape) for a in hits)
            own = np.take_along_axis(parts_around()[wanted], part, 1) | (part == BACKGROUND)
            shows = inside & (depth <= surface + CLOTH_M) & own
            visibility[v, wanted], share[v, wanted] = classify(shows, inside, part)
        return visibility, share
