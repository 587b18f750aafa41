"""Triangle meshes, and actors: meshes with skinning transforms in every frame."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray as Array


@dataclass(frozen=True, eq=False)
class Material:
    """Appearance of a primitive's surface, and its part label."""

    texture: UInt8[Array, "H W 3"]  # sRGB, seamless
    tile: float = 1.0  # metres that one repeat of the texture covers
    shininess: float = 0.0
    glows: bool = False
    casts_shadow: bool | None = None  # None: unless it glows or is a sheet
    part: int | None = None  # None: ROOM for sheets, FURNITURE for solids


@dataclass(frozen=True, eq=False)
class Mesh:
    """A textured triangle mesh, rigid or skinned to an actor's bodies.

    A rigid mesh has `bones` None and its vertices in world coordinates. A skinned one has its
    vertices in the actor's rest pose; a posed vertex is sum_k weights_k * S[bones_k] @ vertex, with
    S (B, 4, 4) the actor's skinning transforms of the frame.
    """

    name: str
    vertices: Float[Array, "N 3"]  # metres
    faces: Int[Array, "F 3"]  # counter-clockwise seen from outside
    uv: Float[Array, "N 2"]  # texture coordinates; (0, 0) is the top-left of `texture`; wraps
    texture: UInt8[Array, "H W 3"]  # sRGB
    parts: UInt8[Array, "N"]  # part label of each vertex (see egocap_sim.core.part_labels)
    bones: Int[Array, "N 4"] | None = None
    weights: Float[Array, "N 4"] | None = None  # rows sum to one
    shininess: float = 0.0  # strength of a soft highlight, 0 to 1
    casts_shadow: bool = True
    double_sided: bool = False
    glows: bool = False  # emits light: a lamp, a window, the sky


@dataclass(frozen=True, eq=False)
class Actor:
    """Meshes that move together under one set of skinning transforms."""

    name: str
    meshes: tuple[Mesh, ...]


@dataclass(frozen=True, eq=False)
class AnimatedActor:
    """An actor and its pose in every frame: a bystander or a prop.

    `skinning` maps each body from its rest pose to the world at the cameras' frame times. `joints`
    are those of a person (axis J as `egocap.body.labels.LABELS`, world, metres), or None.
    """

    actor: Actor
    skinning: Float[Array, "T B 4 4"]
    joints: Float[Array, "T 18 3"] | None = None


def moving(
    name: str, parts: Iterable[tuple[int, Mesh]], transforms: Float[Array, "T B 4 4"]
) -> AnimatedActor:
    """An actor of rigid meshes, each with the index of its transform."""
    return AnimatedActor(Actor(name, tuple(_bound(mesh, k) for k, mesh in parts)), transforms)


def resting(name: str, meshes: Iterable[Mesh], frames: int) -> AnimatedActor:
    """An actor of meshes at rest."""
    return moving(name, [(0, m) for m in meshes], np.tile(np.eye(4), (frames, 1, 1, 1)))


def _bound(mesh: Mesh, k: int) -> Mesh:
    count = len(mesh.vertices)
    return replace(
        mesh, bones=np.full((count, 4), k), weights=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    )
