"""Meshes skinned to a person's bodies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array

from egocap_sim.assets.mesh import Mesh
from egocap_sim.core.bodies import BODIES, INDEX
from egocap_sim.core.part_labels import wearer_part

PART_OF_BODY = np.array([wearer_part(b) for b in BODIES], np.uint8)


@dataclass(frozen=True, eq=False)
class Worn:
    """The mesh of a garment or accessory, and the bare skin vertices that it hides."""

    mesh: Mesh
    hidden: Bool[Array, "N"]


def skinned_mesh(
    name: str,
    vertices: Float[Array, "N 3"],
    faces: Int[Array, "F 3"],
    uv: Float[Array, "N 2"],
    texture: UInt8[Array, "H W 3"],
    weights: Float[Array, "N 21"],
    shininess: float = 0.0,
) -> Mesh:
    """A double-sided mesh skinned to the four bodies with the largest weights."""
    bones = np.argsort(-weights, axis=1, kind="stable")[:, :4]
    kept = np.take_along_axis(weights, bones, 1)
    return Mesh(
        name, vertices, faces.astype(np.int32), uv, texture, PART_OF_BODY[bones[:, 0]],
        bones.astype(np.int32), kept / kept.sum(1, keepdims=True), shininess, double_sided=True,
    )  # fmt: skip


def rigid_mesh(
    name: str,
    vertices: Float[Array, "N 3"],
    faces: Int[Array, "F 3"],
    uv: Float[Array, "N 2"],
    texture: UInt8[Array, "H W 3"],
    body: str,
    shininess: float,
) -> Mesh:
    """A double-sided mesh that follows one body."""
    bones = np.zeros((len(vertices), 4), np.int32)
    bones[:, 0] = INDEX[body]
    weights = np.tile([1.0, 0.0, 0.0, 0.0], (len(vertices), 1))
    return Mesh(
        name, vertices, faces, uv, texture, PART_OF_BODY[bones[:, 0]], bones, weights, shininess,
        double_sided=True,
    )  # fmt: skip
