"""Rigid props as actors."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.assets.mesh import Actor, AnimatedActor, Mesh


def moving(
    name: str, parts: Iterable[tuple[int, Mesh]], transforms: Float[Array, "T B 4 4"]
) -> AnimatedActor:
    """An actor of rigid meshes, each with the number of the transform it follows."""
    return AnimatedActor(Actor(name, tuple(_bound(mesh, k) for k, mesh in parts)), transforms)


def resting(name: str, meshes: Iterable[Mesh], frames: int) -> AnimatedActor:
    """Meshes that stay where they are."""
    return moving(name, [(0, m) for m in meshes], np.tile(np.eye(4), (frames, 1, 1, 1)))


def _bound(mesh: Mesh, k: int) -> Mesh:
    count = len(mesh.vertices)
    return replace(
        mesh, bones=np.full((count, 4), k), weights=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    )
