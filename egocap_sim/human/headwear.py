"""What heads wear: hair as a shell over the scalp, a bicycle helmet, a headset."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from egocap_sim.bodies import INDEX
from egocap_sim.human.anny_model import BareBody, anatomy, skull_middle
from egocap_sim.human.chart import Chart
from egocap_sim.human.noise import smooth_noise
from egocap_sim.human.shell import Cut, Shell, make_shell
from egocap_sim.mesh import Mesh
from egocap_sim.parts import RIG


@dataclass(frozen=True)
class Hair:
    """A haircut: thickness (m) on top and at its edge, and how far down the nape it reaches (m)."""

    top: float
    edge: float
    nape: float


HAIRCUTS: dict[str, Hair | None] = {
    "bald": None,
    "buzz": Hair(0.004, 0.002, 0.02),
    "short": Hair(0.014, 0.004, 0.03),
    "thick": Hair(0.028, 0.010, 0.03),
    "bob": Hair(0.022, 0.018, 0.11),
}
HAIR_COLORS: dict[str, str] = {
    "black": "#17130f", "dark brown": "#2e1f16", "brown": "#4f3522", "light brown": "#7a5a3a",
    "blond": "#b08f5c", "red": "#7d3b1f", "grey": "#86837e", "white": "#cfcbc4",
}  # fmt: skip
HEADGEAR = ("helmet", "headset")


def fit_hair(body: BareBody, chart: Chart, hair: Hair) -> tuple[Shell, Bool[Array, "N"]]:
    """Hair over the scalp, and the skin it hides."""
    skull, up = _skull(body)
    x, y, z = (body.vertices - skull).T
    # The hairline: high on the forehead, down in front of the ears, low at the nape.
    line = np.interp(x / up, [-1.0, -0.2, 0.15, 0.55, 1.1], [-1, -0.75, -0.25, 0.45, 0.62]) * up
    line = line - np.where(x < 0.1 * up, hair.nape * np.clip(0.6 - x / up, 0, 1), 0)
    ears = np.hypot(x + 0.02 * up, z + 0.45 * up) - 0.42 * up
    on_head = np.isin(anatomy().owner, [INDEX["head"], INDEX["neck"]])
    inside = np.where(on_head, z - line, -1.0)
    if hair.nape < 0.06:
        inside = np.where(np.abs(y) > 0.55 * up, np.minimum(inside, ears), inside)
    cut = Cut([inside], margin=0.02)
    rise = np.clip(inside / 0.05, 0, 1)
    gap = hair.edge * 0.5 + 0.001 + 0 * z
    return make_shell(
        body, chart, cut, gap, hair.edge / 2 + (hair.top - hair.edge) * rise
    ), cut.covered(body.vertices)


def hair_texture(color: Float[Array, "3"], rng: np.random.Generator) -> UInt8[Array, "256 256 3"]:
    """Strands running down the head."""
    strands = 0.25 * smooth_noise(256, (4, 128), rng) + 0.15 * smooth_noise(256, (3, 32), rng)
    return np.rint(np.clip(color * (1 + strands[..., None]), 0, 1) * 255).astype(np.uint8)


def make_helmet(body: BareBody, color: Float[Array, "3"]) -> Mesh:
    """A bicycle helmet around the top of the skull, its rim just above the brows."""
    skull, up = _skull(body)
    rings, around = 12, 40
    turn = 2 * np.pi * np.arange(around) / around
    points, rows = [], []
    rim = np.radians(98)
    for i, angle in enumerate(np.linspace(0.02, rim, rings)):
        radii = np.array([1.28, 1.12, 1.22]) * up + 0.022
        ribs = 1 + 0.035 * np.cos(6 * turn) * np.sin(angle)
        out = np.stack([np.cos(turn), np.sin(turn)], 1) * np.sin(angle) * ribs[:, None]
        drop = -0.012 * np.cos(turn) * (angle / rim) ** 4  # the rim is lower at the nape
        z = radii[2] * np.cos(angle) - drop
        points.append(np.column_stack([out * radii[:2], z]))
        rows.append(i / rings)
    points.append(points[-1] * [0.86, 0.86, 1] - [0, 0, 0.006])  # the rim's edge, turned inward
    rows.append(0.99)
    vertices = np.concatenate(points) + skull + [0.004, 0, 0.2 * up]
    return _head_mesh("helmet", vertices, _rings_faces(len(points), around), rows, around, color)


def make_headset(body: BareBody, color: Float[Array, "3"]) -> Mesh:
    """A box before the eyes and a strap around the head."""
    skull, up = _skull(body)
    around = 48
    turn = 2 * np.pi * np.arange(around) / around
    front = np.clip(2.2 * np.cos(turn) - 1.0, 0, 1)
    eyes = -0.32 * up
    profile = [(-1.0, 0.96), (-1.0, 1.0), (1.0, 1.0), (1.0, 0.96)]
    points = []
    for side, size in profile:
        half = 0.016 + 0.030 * front
        reach = size * np.stack([1.24 * up + 0.075 * front, 1.06 * up + 0.01 + 0 * turn], 1)
        xy = np.stack([np.cos(turn), np.sin(turn)], 1) * reach
        squared = 1 + 0.22 * front * np.abs(np.sin(turn))
        points.append(np.column_stack([xy * squared[:, None], side * half + eyes * front]))
    vertices = np.concatenate(points) + skull
    rows = [0.0, 0.3, 0.7, 1.0]
    faces = _rings_faces(len(points), around)[:, ::-1]
    return _head_mesh("headset", vertices, faces, rows, around, color)


def _skull(body: BareBody) -> tuple[Float[Array, "3"], float]:
    """Middle of the skull and its half width (m)."""
    head = body.vertices[anatomy().owner == INDEX["head"]]
    middle = skull_middle(head)
    return middle, float(head[:, 2].max() - middle[2])


def _rings_faces(rings: int, around: int) -> Array:
    ring = np.arange(around)
    after = (ring + 1) % around
    strips = []
    for i in range(rings - 1):
        a, b = i * around, (i + 1) * around
        strips.append(np.stack([a + ring, b + ring, b + after], 1))
        strips.append(np.stack([a + ring, b + after, a + after], 1))
    return np.concatenate(strips).astype(np.int32)


def _head_mesh(
    name: str, vertices: Array, faces: Array, rows: list[float], around: int, color: Array
) -> Mesh:
    texture = np.broadcast_to(np.rint(color * 255).astype(np.uint8), (64, 64, 3)).copy()
    texture[8:14] = np.rint(color * 110).astype(np.uint8)
    u = np.tile(np.arange(around) / around, len(rows))
    bones = np.zeros((len(vertices), 4), np.int32)
    bones[:, 0] = INDEX["head"]
    return Mesh(
        name=name,
        vertices=vertices,
        faces=faces,
        uv=np.stack([u, np.repeat(rows, around)], 1),
        texture=texture,
        parts=np.full(len(vertices), RIG, np.uint8),
        bones=bones,
        weights=np.tile([1.0, 0.0, 0.0, 0.0], (len(vertices), 1)),
        shininess=0.4,
        double_sided=True,
    )
