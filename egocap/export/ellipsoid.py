"""Ellipsoids along bones: the figure of an exported animation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray as Array

from egocap.geometry import unit

_RADIUS = {
    "skull": 0.085, "neck": 0.055, "upper_spine": 0.11, "lower_spine": 0.11, "clavicle": 0.045,
    "shoulder": 0.045, "elbow": 0.038, "wrist": 0.03, "hip": 0.07, "knee": 0.05, "ankle": 0.038,
}  # fmt: skip
"""Metres, by the joint that a bone turns about."""
_AROUND, _ALONG = 12, 8  # corners of a ring, and rings from end to end


class Mesh(NamedTuple):
    """Triangles with one bone and one colour a vertex."""

    vertices: Float[Array, "N 3"]  # metres
    normals: Float[Array, "N 3"]
    faces: Int[Array, "F 3"]
    bone: Int[Array, "N"]
    colour: UInt8[Array, "N 3"]


def bone_mesh(
    start: Float[Array, "3"], along: Float[Array, "3"], body: str, bone: int,
    colour: Sequence[int],
) -> Mesh:  # fmt: skip
    """An ellipsoid from `start` to `start + along`, of the thickness of a body part."""
    length = float(np.linalg.norm(along))
    half = max(length / 2, 0.02)
    radius = min(_RADIUS[body.removeprefix("left_").removeprefix("right_")], 1.2 * half)
    axis = unit(along) if length > 1e-6 else np.array([0.0, 1.0, 0.0])
    side = unit(np.cross(axis, np.eye(3)[np.abs(axis).argmin()]))
    frame = np.stack([side, np.cross(axis, side), axis])
    sphere, faces = _sphere()
    vertices = start + along / 2 + (sphere * [radius, radius, half]) @ frame
    normals = unit(sphere / [radius, radius, half]) @ frame
    count = len(vertices)
    return Mesh(vertices, normals, faces, np.full(count, bone),
                np.tile(np.array(colour, np.uint8), (count, 1)))  # fmt: skip


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """All meshes as one."""
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + begin for mesh, begin in zip(meshes, first, strict=False)]
    return Mesh(
        np.concatenate([m.vertices for m in meshes]), np.concatenate([m.normals for m in meshes]),
        np.concatenate(faces), np.concatenate([m.bone for m in meshes]),
        np.concatenate([m.colour for m in meshes]),
    )  # fmt: skip


def _sphere() -> tuple[Float[Array, "N 3"], Int[Array, "F 3"]]:
    """The unit sphere, poles along z, triangles counter-clockwise from outside."""
    polar = np.linspace(0, np.pi, _ALONG + 1)[1:-1, None]
    turn = np.linspace(0, 2 * np.pi, _AROUND, endpoint=False)[None]
    ring = np.stack(np.broadcast_arrays(
        np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)), -1)  # fmt: skip
    vertices = np.concatenate([[[0.0, 0.0, 1.0]], ring.reshape(-1, 3), [[0.0, 0.0, -1.0]]])
    a = np.arange(_AROUND)
    b, last = (a + 1) % _AROUND, len(vertices) - 1
    faces = [np.stack([0 * a, 1 + a, 1 + b], 1)]
    for row in range(_ALONG - 2):
        up, down = 1 + row * _AROUND, 1 + (row + 1) * _AROUND
        faces += [
            np.stack([up + a, down + a, down + b], 1),
            np.stack([up + a, down + b, up + b], 1),
        ]
    end = 1 + (_ALONG - 2) * _AROUND
    faces.append(np.stack([end + a, 0 * a + last, end + b], 1))
    return vertices, np.concatenate(faces)
