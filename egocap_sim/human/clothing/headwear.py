"""What carries the rig: a bicycle helmet, a headset."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray as Array

from egocap_sim.assets.mesh import Mesh
from egocap_sim.core.bodies import INDEX
from egocap_sim.core.part_labels import RIG
from egocap_sim.human.body.anny_model import BareBody
from egocap_sim.human.body.skull import skull_of

HEADGEAR = ("helmet", "headset")


def make_helmet(body: BareBody, color: Float[Array, "3"]) -> Mesh:
    """A bicycle helmet around the top of the skull, its rim just above the brows."""
    skull = skull_of(body)
    rings, around = 12, 48
    turn = np.linspace(0, 2 * np.pi, around + 1)
    rim = np.radians(100)
    half = skull.half + [0.030, 0.022, 0.026]
    points = []
    for angle in np.linspace(0.02, rim, rings):
        ribs = 1 + 0.03 * np.cos(6 * turn) * np.sin(angle) ** 2
        out = np.stack([np.cos(turn), np.sin(turn)], 1) * (np.sin(angle) * ribs)[:, None]
        tilt = 0.014 * np.cos(turn) * (angle / rim) ** 4  # the rim is lower at the nape
        points.append(np.column_stack([out * half[:2], half[2] * np.cos(angle) + tilt]))
    points.append(points[-1] * [0.86, 0.86, 1] - [0, 0, 0.006])  # the rim's edge, turned inward
    vertices = np.concatenate(points) + skull.centre + [0.002, 0, 0.2 * skull.half[2]]
    rows = np.append(np.arange(rings) / rings, 0.99)
    texture = _plain_texture(color)
    y, x = np.mgrid[0:128, 0:128] / 128
    vents = ((x * 6 + 0.5) % 1 - 0.5) ** 2 / 0.03 + (y - 0.48) ** 2 / 0.035 < 1
    texture[vents | (y > 0.95)] = 24
    return _head_mesh("helmet", vertices, ring_faces(rings + 1, around), rows, around, texture)


def make_headset(body: BareBody, color: Float[Array, "3"]) -> Mesh:
    """A box before the eyes and a strap around the head."""
    skull = skull_of(body)
    around = 48
    turn = np.linspace(0, 2 * np.pi, around + 1)
    front = np.clip(2.2 * np.cos(turn) - 1.0, 0, 1)
    around_head = np.stack([np.cos(turn), np.sin(turn)], 1)
    squared = (1 + 0.18 * front * np.abs(np.sin(turn)))[:, None]
    inner = around_head * skull.half[:2] * 0.95  # inside the head: closes the box
    reach = np.stack([skull.half[0] + 0.022 + 0.050 * front, skull.half[1] + 0.020 + 0 * turn], 1)
    outer = around_head * squared * reach
    points = []
    for side, ring in ((-1.0, inner), (-1.0, outer), (1.0, outer), (1.0, inner)):
        height = side * (0.016 + 0.030 * front) - 0.40 * skull.half[2] * front
        points.append(np.column_stack([ring, height]))
    vertices = np.concatenate(points) + skull.centre
    faces = ring_faces(len(points), around)[:, ::-1]
    rows = np.array([0.0, 0.3, 0.7, 1.0])
    return _head_mesh("headset", vertices, faces, rows, around, _plain_texture(color))


def _plain_texture(color: Float[Array, "3"]) -> UInt8[Array, "128 128 3"]:
    return np.broadcast_to(np.rint(color * 255).astype(np.uint8), (128, 128, 3)).copy()


def ring_faces(rings: int, around: int) -> Int[Array, "F 3"]:
    """Triangles between rings of around + 1 points, whose last lies on the first."""
    ring = np.arange(around)
    strips = []
    for i in range(rings - 1):
        a, b = i * (around + 1), (i + 1) * (around + 1)
        strips.append(np.stack([a + ring, b + ring, b + ring + 1], 1))
        strips.append(np.stack([a + ring, b + ring + 1, a + ring + 1], 1))
    return np.concatenate(strips).astype(np.int32)


def _head_mesh(
    name: str, vertices: Array, faces: Array, rows: Array, around: int, texture: Array
) -> Mesh:
    u = np.tile(np.arange(around + 1) / around, len(rows))
    bones = np.zeros((len(vertices), 4), np.int32)
    bones[:, 0] = INDEX["head"]
    return Mesh(
        name=name,
        vertices=vertices,
        faces=faces,
        uv=np.stack([u, np.repeat(rows, around + 1)], 1),
        texture=texture,
        parts=np.full(len(vertices), RIG, np.uint8),
        bones=bones,
        weights=np.tile([1.0, 0.0, 0.0, 0.0], (len(vertices), 1)),
        shininess=0.4,
        double_sided=True,
    )
