"""The things of a scene as obstacles: a box around each of their meshes, in every frame."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from egocap.geometry import transform
from egocap_sim.assets.mesh import AnimatedActor, Mesh

Boxes = Float[Array, "B T 2 3"]  # lowest and highest corner in the world, metres


def thing_boxes(things: Sequence[AnimatedActor], frames: Int[Array, "T"]) -> Boxes:
    """Axis-aligned boxes around the meshes of things, each of which moves with one bone."""
    boxes = [_box(mesh, thing.skinning[frames]) for thing in things for mesh in thing.actor.meshes]
    return np.array(boxes).reshape(-1, len(frames), 2, 3)


def _box(mesh: Mesh, skinning: Float[Array, "T B 4 4"]) -> Float[Array, "T 2 3"]:
    assert mesh.bones is not None, mesh.name
    ends = np.stack([mesh.vertices.min(0), mesh.vertices.max(0)], 1)
    corners = transform(skinning[:, mesh.bones[0, 0]], np.array(list(product(*ends))))
    return np.stack([corners.min(1), corners.max(1)], 1)


def distance_to_boxes(points: Float[Array, "T P 3"], boxes: Boxes) -> float:
    """Least distance of points from boxes in the same frames; 0 inside, infinite without boxes."""
    least = np.inf
    for box in boxes:
        low, high = box[:, :1], box[:, 1:]
        out = np.maximum(np.maximum(low - points, points - high), 0.0)
        least = min(least, float(np.linalg.norm(out, axis=-1).min()))
    return least
