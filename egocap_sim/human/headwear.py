"""What heads wear: hair as a shell over the scalp, a bicycle helmet, a headset."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
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
COVERS_EARS = 0.06  # m down the nape from which hair falls over the ears
EAR = (-0.1, -0.45)  # middle of the ears, forward and up, in halves of the skull


def fit_hair(body: BareBody, chart: Chart, hair: Hair) -> tuple[Shell, Bool[Array, "N"]]:
    """Hair over the scalp, and the skin it hides. Long hair covers the ears, short hair goes round.

    The hairline is high on the forehead, runs down before the ears, and is low at the nape.
    """
    skull = _skull(body)
    x, y, z = (body.vertices - skull.centre).T / skull.half[:, None]
    line = np.interp(x, [-1.0, -0.2, 0.15, 0.55, 1.0], [-0.75, -0.6, -0.15, 0.42, 0.56])
    line = skull.half[2] * line - np.where(x < 0.1, hair.nape * np.clip(0.6 - x, 0, 1), 0)
    inside = body.vertices[:, 2] - skull.centre[2] - line
    ear = (np.abs(y) > 0.97) & (np.abs(x + 0.1) < 0.6) & (z < 0.1) & (z > -1.1)
    if hair.nape < COVERS_EARS:
        around = np.linalg.norm((np.stack([x, z], 1) - EAR) * skull.half[[0, 2]], axis=1)
        inside = np.where(np.abs(y) > 0.6, np.minimum(inside, around - 0.036), inside)
    else:
        inside = np.where(ear, np.maximum(inside, 0.03), inside)
    on_head = np.isin(anatomy().owner, [INDEX["head"], INDEX["neck"]])
    cut = Cut([np.where(on_head, inside, -1.0)], margin=0.02)
    rise = np.clip(inside / 0.05, 0, 1)
    gap = np.where(ear, -0.05, hair.edge * 0.5 + 0.001)
    shell = make_shell(
        body, chart, cut, gap, hair.edge / 2 + (hair.top - hair.edge) * rise, rounds=40
    )
    return shell, cut.covered(body.vertices) | (ear & (hair.nape >= COVERS_EARS))


def hair_texture(color: Float[Array, "3"], rng: np.random.Generator) -> UInt8[Array, "128 128 3"]:
    """Strands running down the head."""
    strands = 0.3 * smooth_noise(128, (3, 64), rng) + 0.15 * smooth_noise(128, (2, 16), rng)
    return np.rint(np.clip(color * (1 + strands[..., None]), 0, 1) * 255).astype(np.uint8)


def make_helmet(body: BareBody, color: Float[Array, "3"]) -> Mesh:
    """A bicycle helmet around the top of the skull, its rim just above the brows."""
    skull = _skull(body)
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
    return _head_mesh("helmet", vertices, _rings_faces(rings + 1, around), rows, around, texture)


def make_headset(body: BareBody, color: Float[Array, "3"]) -> Mesh:
    """A box before the eyes and a strap around the head."""
    skull = _skull(body)
    around = 48
    turn = np.linspace(0, 2 * np.pi, around + 1)
    front = np.clip(2.2 * np.cos(turn) - 1.0, 0, 1)
    around_head = np.stack([np.cos(turn), np.sin(turn)], 1)
    squared = (1 + 0.18 * front * np.abs(np.sin(turn)))[:, None]
    inner = around_head * skull.half[:2] * 0.95  # inside the head: closes the box
    reach = np.stack([skull.half[0] + 0.012 + 0.060 * front, skull.half[1] + 0.010 + 0 * turn], 1)
    outer = around_head * squared * reach
    points = []
    for side, ring in ((-1.0, inner), (-1.0, outer), (1.0, outer), (1.0, inner)):
        height = side * (0.016 + 0.030 * front) - 0.40 * skull.half[2] * front
        points.append(np.column_stack([ring, height]))
    vertices = np.concatenate(points) + skull.centre
    faces = _rings_faces(len(points), around)[:, ::-1]
    rows = np.array([0.0, 0.3, 0.7, 1.0])
    return _head_mesh("headset", vertices, faces, rows, around, _plain_texture(color))


@dataclass(frozen=True, eq=False)
class _Skull:
    centre: Float[Array, "3"]  # of the brain case, world at rest
    half: Float[Array, "3"]  # half its length, width and height (m), without ears and nose


def _skull(body: BareBody) -> _Skull:
    head = body.vertices[anatomy().owner == INDEX["head"]]
    middle = skull_middle(head)
    crown = head[head[:, 2] > middle[2] + 0.2 * (head[:, 2].max() - middle[2])]
    low, high = crown.min(0), crown.max(0)
    centre = np.array([(low[0] + high[0]) / 2, 0.0, middle[2]])
    return _Skull(centre, np.array([*(high - low)[:2] / 2, high[2] - middle[2]]))


def _plain_texture(color: Float[Array, "3"]) -> UInt8[Array, "128 128 3"]:
    return np.broadcast_to(np.rint(color * 255).astype(np.uint8), (128, 128, 3)).copy()


def _rings_faces(rings: int, around: int) -> Int[Array, "F 3"]:
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
