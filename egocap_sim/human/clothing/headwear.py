"""Hats, and the headgear that carries the rig: a bicycle helmet, a headset. All are ring meshes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from egocap_sim.assets.mesh import Mesh
from egocap_sim.assets.textures import even
from egocap_sim.core.bodies import INDEX
from egocap_sim.core.part_labels import RIG
from egocap_sim.human.body.anny_model import anatomy
from egocap_sim.human.body.body_chart import BodyChart, Skull
from egocap_sim.human.body.skin import rgb
from egocap_sim.human.body.skinning import Worn, rigid_mesh
from egocap_sim.human.body.triangles import ring_faces
from egocap_sim.human.clothing.fabric import PALETTE, fabric_texture, one_color

AROUND = 48  # segments of each ring of a helmet and a headset


def make_helmet(skull: Skull, rng: np.random.Generator) -> Mesh:
    """A bicycle helmet around the top of the skull, its rim just above the brows."""
    rings, turn = 12, np.linspace(0, 2 * np.pi, AROUND + 1)
    rim = np.radians(100)
    half = skull.half + [0.030, 0.022, 0.026]
    points = []
    for angle in np.linspace(0.02, rim, rings):
        ribs = 1 + 0.03 * np.cos(6 * turn) * np.sin(angle) ** 2
        out = np.stack([np.cos(turn), np.sin(turn)], 1) * (np.sin(angle) * ribs)[:, None]
        tilt = 0.014 * np.cos(turn) * (angle / rim) ** 4  # lowers the rim at the nape
        points.append(np.column_stack([out * half[:2], half[2] * np.cos(angle) + tilt]))
    points.append(points[-1] * [0.86, 0.86, 1] - [0, 0, 0.006])  # the rim's edge, turned inward
    vertices = np.concatenate(points) + skull.centre + [0.002, 0, 0.2 * skull.half[2]]
    rows = np.append(np.arange(rings) / rings, 0.99)
    names = list(PALETTE)
    texture = plain_texture(128, names[rng.integers(len(names))])
    y, x = np.mgrid[0:128, 0:128] / 128
    vents = ((x * 6 + 0.5) % 1 - 0.5) ** 2 / 0.03 + (y - 0.48) ** 2 / 0.035 < 1
    texture[vents | (y > 0.95)] = 24
    return _headgear("helmet", vertices, rows, texture)


def make_headset(skull: Skull, _rng: np.random.Generator) -> Mesh:
    """A black box in front of the eyes and a strap around the head."""
    turn = np.linspace(0, 2 * np.pi, AROUND + 1)
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
    texture = plain_texture(128, "black")
    mesh = _headgear("headset", vertices, np.array([0.0, 0.3, 0.7, 1.0]), texture)
    return replace(mesh, faces=mesh.faces[:, ::-1])


HEADGEAR = {"helmet": make_helmet, "headset": make_headset}


def cap(chart: BodyChart, rng: np.random.Generator) -> Worn:
    """A cap with a visor."""
    return _hat(
        "cap", chart, rng, lambda turn: 0.075 * np.clip(1.6 * np.cos(turn) - 0.6, 0, 1) ** 0.5, 1.0
    )


def sun_hat(chart: BodyChart, rng: np.random.Generator) -> Worn:
    """A hat with a wide brim all around."""
    return _hat("hat", chart, rng, lambda turn: 0.085 + 0 * turn, 1.12)


def beanie(chart: BodyChart, rng: np.random.Generator) -> Worn:
    """A knitted cap without a brim."""
    return _hat("beanie", chart, rng, lambda turn: 0 * turn, 1.10, pattern="knit")


def _hat(
    name: str,
    chart: BodyChart,
    rng: np.random.Generator,
    brim: Callable[[Array], Array],
    crown: float,
    pattern: str = "plain",
) -> Worn:
    """A dome around skull and hair; `brim` gives its width (m) by azimuth (0 forward)."""
    skull, around, rings = chart.skull, 40, 8
    turn = np.linspace(0, 2 * np.pi, around + 1)
    half = skull.half + [0.020, 0.018, 0.022]
    points = []
    for angle in np.linspace(0.02, np.pi / 2, rings):
        ring = np.stack([np.cos(turn), np.sin(turn)], 1) * np.sin(angle) ** 0.8
        height = np.full(around + 1, crown * half[2] * np.cos(angle))
        points.append(np.column_stack([ring * half[:2], height]))
    rim, width = points[-1], brim(turn)[:, None]
    out = np.column_stack([np.cos(turn), np.sin(turn), np.full(around + 1, -0.22)]) * width
    points += [rim + 0.5 * out, rim + out, rim + out - [0, 0, 0.003]]
    points.append(rim * [0.97, 0.97, 1] - [0, 0, 0.004])
    vertices = np.concatenate(points) + skull.centre + [0, 0, 0.12 * skull.half[2]]
    cloth = one_color(pattern, str(rng.choice(list(PALETTE))))
    texture = np.tile(fabric_texture(cloth, rng), (2, 2, 1))
    texture[: len(texture) // 16] = np.clip(texture[: len(texture) // 16] * 0.7, 0, 255)
    rows = np.append(np.linspace(0.02, 0.8, rings), [0.9, 0.97, 0.98, 0.99])
    uv = np.stack([np.tile(turn / np.pi, len(rows)), np.repeat(rows, around + 1)], 1)
    head = anatomy().owner == INDEX["head"]
    hidden = head & (chart.vertices[:, 2] > skull.centre[2] + 0.35 * skull.half[2])
    faces = ring_faces(len(rows), around)
    return Worn(rigid_mesh(name, vertices, faces, uv, texture, "head", 0.05), hidden)


def plain_texture(size: int, color: str) -> UInt8[Array, "size size 3"]:
    """A square of one colour of `PALETTE`."""
    return np.tile(even(rgb(PALETTE[color])).texture, (size // 4, size // 4, 1))


def _headgear(name: str, vertices: Array, rows: Array, texture: Array) -> Mesh:
    """A mesh of rings on the head, labelled as the rig; `rows` are their v in the texture."""
    u = np.tile(np.arange(AROUND + 1) / AROUND, len(rows))
    uv = np.stack([u, np.repeat(rows, AROUND + 1)], 1)
    mesh = rigid_mesh(name, vertices, ring_faces(len(rows), AROUND), uv, texture, "head", 0.4)
    return replace(mesh, parts=np.full(len(vertices), RIG, np.uint8))
