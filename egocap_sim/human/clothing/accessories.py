"""Gloves, watches and glasses, and the table of all accessories."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.geometry import unit
from egocap_sim.core.bodies import INDEX
from egocap_sim.human.body.anny_model import anatomy
from egocap_sim.human.body.anny_source import REGIONS
from egocap_sim.human.body.body_chart import LEFT_ARM, BodyChart
from egocap_sim.human.body.skinning import Worn, rigid_mesh
from egocap_sim.human.body.triangles import ring_faces
from egocap_sim.human.clothing.fabric import TILE_M, fabric_texture, one_color
from egocap_sim.human.clothing.headwear import beanie, cap, plain_texture, sun_hat
from egocap_sim.human.clothing.shell import ELSEWHERE, Pattern, make_shell
from egocap_sim.human.clothing.tailoring import Cloth, sew

Fit = Callable[[BodyChart, np.random.Generator], Worn]

GLOVE_COLORS = ("black", "charcoal", "brown", "navy", "red", "olive", "grey")
FRAME_COLORS = ("black", "charcoal", "brown", "burgundy", "grey")
STRAP_COLORS = ("black", "brown", "charcoal", "navy")
EYE_FORWARD = 0.021  # m from the front of the eyes to the rims
TURN = np.linspace(0, 2 * np.pi, 25)


def gloves(chart: BodyChart, rng: np.random.Generator) -> Worn:
    """Knitted or leather gloves up to the wrist."""
    edge = np.where(chart.on_arm, chart.along_arm - (chart.wrist - 0.03), -ELSEWHERE)
    pattern = Pattern([edge], np.full(len(edge), 0.0012), margin=0.01, rounds=1)
    cloth = one_color(str(rng.choice(["plain", "knit"])), str(rng.choice(GLOVE_COLORS)))
    knit = Cloth(fabric_texture(cloth, rng), TILE_M, rng, 0.2)
    return sew("gloves", make_shell(chart, pattern), chart.body, knit)


def watch(chart: BodyChart, rng: np.random.Generator) -> Worn:
    """A wrist watch on the left arm: strap and dial."""
    elbow, wrist = chart.joint("l_forearm"), chart.joint("l_hand")
    axis = unit(wrist - elbow)
    near = (chart.piece == LEFT_ARM) & (np.abs(chart.along_arm - chart.wrist + 0.03) < 0.018)
    ring = chart.vertices[near]
    back = _back_of_hand(chart)
    e1 = unit(back - (back @ axis) * axis)
    e2 = np.cross(axis, e1)
    centre = elbow + axis * (np.linalg.norm(wrist - elbow) - 0.03)
    centre = centre + sum(e * np.mean([(ring - centre) @ e]) for e in (e1, e2))
    out = ring - centre
    half = np.array([np.abs(out @ e1).max(), np.abs(out @ e2).max()]) + 0.003
    loop = half[0] * np.cos(TURN)[:, None] * e1 + half[1] * np.sin(TURN)[:, None] * e2
    strap = [(0.90, -0.010), (1.0, -0.010), (1.0, 0.010), (0.90, 0.010)]  # scale, m along the arm
    disc = 0.019 * (np.cos(TURN)[:, None] * axis + np.sin(TURN)[:, None] * e2)
    dial = [(1.0, -0.004), (1.0, 0.006), (0.9, 0.008), (0.0, 0.008)]  # scale, m over the strap
    rings = [centre + loop * s + axis * h for s, h in strap]
    rings += [centre + disc * s + e1 * (half[0] + h) for s, h in dial]
    rows = [0.05, 0.1, 0.2, 0.25, 0.45, 0.5, 0.6, 0.97]
    uv = np.stack([np.tile(TURN / (2 * np.pi), 8), np.repeat(rows, 25)], 1)
    texture = plain_texture(64, str(rng.choice(STRAP_COLORS)))
    texture[26:38] = (178, 176, 170)
    texture[38:] = (24, 26, 30) if rng.uniform() < 0.6 else (232, 230, 224)
    faces = np.concatenate([ring_faces(4, 24), ring_faces(4, 24) + 100])
    return _over_skin(chart, np.concatenate(rings), faces, uv, texture, "watch", "l_forearm")


def glasses(chart: BodyChart, rng: np.random.Generator) -> Worn:
    """Rims in front of the eyes, a bridge and temples, without lenses."""
    shape, skull = anatomy(), chart.skull
    eyes = []
    for side in ("eye_front.L", "eye_front.R"):
        eye = chart.vertices[np.unique(shape.faces[shape.region == REGIONS.index(side)])]
        eyes.append(np.array([eye[:, 0].max(), eye[:, 1].mean(), eye[:, 2].mean()]))
    ahead = max(e[0] for e in eyes) + EYE_FORWARD
    half = np.array([rng.uniform(0.022, 0.026), rng.uniform(0.016, 0.023)])
    power = 2 / rng.uniform(2.0, 3.5)  # of a superellipse: 1 is round, less is squarer
    c, s = np.cos(TURN), np.sin(TURN)
    outline = np.stack([np.sign(k) * np.abs(k) ** power for k in (c, s)], 1)
    tubes = []
    for eye in eyes:
        loop = np.column_stack([np.full(25, ahead), outline * half + eye[1:] - [0, 0.003]])
        loop[:, 0] -= 0.25 * np.abs(loop[:, 1]) ** 2 / 0.05  # curved around the face
        tubes.append(loop)
    y = np.linspace(eyes[0][1] - half[0], eyes[1][1] + half[0], 7)
    z = eyes[0][2] + 0.004 + 0.004 * np.cos(np.linspace(-1.5, 1.5, 7))
    tubes.append(np.column_stack([np.full(7, ahead), y, z]))
    for sign, (_, y, z) in zip((1, -1), eyes, strict=True):
        x = ahead - 0.25 * (abs(y) + half[0]) ** 2 / 0.05
        hinge = np.array([x, y + sign * half[0], z + 0.006])
        ear = np.array([skull.centre[0] - 0.015, sign * (skull.half[1] + 0.006), z + 0.004])
        corner = hinge * [1, 0, 1] + [-0.008, ear[1], 0]
        tubes.append(np.array([hinge, corner, ear, ear + [-0.025, 0, -0.022]]))
    thick = rng.uniform(0.0011, 0.0024)
    vertices = [_tube_around(tube, thick) for tube in tubes]
    starts = np.cumsum([0, *map(len, vertices)])
    faces = [ring_faces(len(t), 4) + k for t, k in zip(tubes, starts[:-1], strict=True)]
    uv, points = np.full((starts[-1], 2), 0.5), np.concatenate(vertices)
    texture = plain_texture(8, str(rng.choice(FRAME_COLORS)))
    return _over_skin(
        chart, points, np.concatenate(faces).astype(np.int32), uv, texture, "glasses", "head"
    )


ACCESSORIES: dict[str, dict[str, Fit]] = {
    "gloves": {"gloves": gloves},
    "watch": {"watch": watch},
    "glasses": {"glasses": glasses},
    "hat": {"cap": cap, "sun_hat": sun_hat, "beanie": beanie},
}
"""Accessories by the field of `Outfit` that they fill; 'none' is valid for each."""


def _over_skin(
    chart: BodyChart, vertices: Array, faces: Array, uv: Array, texture: Array, name: str, body: str
) -> Worn:
    """A shiny rigid mesh that hides no skin."""
    mesh = rigid_mesh(name, vertices, faces, uv, texture, body, 0.5)
    return Worn(mesh, np.zeros(len(chart.vertices), bool))


def _back_of_hand(chart: BodyChart) -> Float[Array, "3"]:
    """Unit normal of the back of the left hand."""
    hand = chart.vertices[anatomy().owner == INDEX["l_hand"]]
    flat = np.linalg.svd(hand - hand.mean(0), full_matrices=False)[2][2]
    return flat if flat @ [0.2, 1.0, 0.6] > 0 else -flat


def _tube_around(path: Float[Array, "R 3"], radius: float) -> Float[Array, "5*R 3"]:
    """Vertices of a four-sided tube around a line."""
    along = unit(np.gradient(path, axis=0))
    side = unit(np.cross(along, [0.35, 0.2, 0.91]))
    up = np.cross(side, along)
    turn = np.linspace(0, 2 * np.pi, 5)
    ring = np.cos(turn)[:, None, None] * side + np.sin(turn)[:, None, None] * up
    return (path + radius * ring).transpose(1, 0, 2).reshape(-1, 3)
