"""Gloves, watches, glasses and hats."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.geometry import unit
from egocap_sim.assets.mesh import Mesh
from egocap_sim.core.bodies import INDEX
from egocap_sim.human.body.anny_model import BareBody, anatomy
from egocap_sim.human.body.anny_source import REGIONS
from egocap_sim.human.body.body_chart import LEFT_ARM, RIGHT_ARM, Chart
from egocap_sim.human.body.skin import PART_OF_BODY, rgb
from egocap_sim.human.body.skull import skull_of
from egocap_sim.human.clothing.fabric import PALETTE, TILE_M, fabric_texture, one_color
from egocap_sim.human.clothing.headwear import ring_faces
from egocap_sim.human.clothing.sewing import sew
from egocap_sim.human.clothing.shell import ELSEWHERE, Cut, make_shell
from egocap_sim.human.clothing.tailoring import Cloth

Worn = tuple[Mesh, Bool[Array, "N"]]  # what is drawn, and the skin it hides
Fit = Callable[[BareBody, Chart, np.random.Generator], Worn]

GLOVE_COLORS = ("black", "charcoal", "brown", "navy", "red", "olive", "grey")
FRAME_COLORS = ("black", "charcoal", "brown", "burgundy", "grey")
EYE_FORWARD = 0.021  # m from the eyes' front to the rims


def gloves(body: BareBody, chart: Chart, rng: np.random.Generator) -> Worn:
    """Knitted or leather gloves up to the wrist."""
    arm = np.isin(chart.piece, (LEFT_ARM, RIGHT_ARM))
    cut = Cut([np.where(arm, chart.arm - (chart.wrist - 0.03), -ELSEWHERE)], margin=0.01)
    gap = np.full(len(arm), 0.0012)
    shell = make_shell(body, chart, cut, gap, 0 * gap, rounds=1)
    cloth = one_color(str(rng.choice(["plain", "knit"])), str(rng.choice(GLOVE_COLORS)))
    return (
        sew("gloves", shell, body, Cloth(fabric_texture(cloth, rng), TILE_M, rng, 0.2)),
        cut.covered(body.vertices),
    )


def watch(body: BareBody, chart: Chart, rng: np.random.Generator) -> Worn:
    """A wrist watch on the left arm: strap and dial."""
    elbow, wrist = body.joints[INDEX["l_forearm"]], body.joints[INDEX["l_hand"]]
    axis = unit(wrist - elbow)
    near = (chart.piece == LEFT_ARM) & (np.abs(chart.arm - chart.wrist + 0.03) < 0.018)
    ring = body.vertices[near]
    back = _back_of_hand(body)
    e1 = unit(back - (back @ axis) * axis)
    e2 = np.cross(axis, e1)
    centre = elbow + axis * (np.linalg.norm(wrist - elbow) - 0.03)
    centre = centre + sum(e * np.mean([(ring - centre) @ e]) for e in (e1, e2))
    out = ring - centre
    half = np.array([np.abs(out @ e1).max(), np.abs(out @ e2).max()]) + 0.003
    turn = np.linspace(0, 2 * np.pi, 25)
    loop = half[0] * np.cos(turn)[:, None] * e1 + half[1] * np.sin(turn)[:, None] * e2
    rows = [(0.90, -0.010), (1.0, -0.010), (1.0, 0.010), (0.90, 0.010)]
    strap = np.concatenate([centre + loop * s + axis * h for s, h in rows])
    dial_turn = np.linspace(0, 2 * np.pi, 25)
    disc = 0.019 * (np.cos(dial_turn)[:, None] * axis + np.sin(dial_turn)[:, None] * e2)
    heights = [
        (1.0, half[0] - 0.004),
        (1.0, half[0] + 0.006),
        (0.9, half[0] + 0.008),
        (0.0, half[0] + 0.008),
    ]
    dial = np.concatenate([centre + disc * s + e1 * h for s, h in heights])
    vertices = np.concatenate([strap, dial])
    u = np.tile(turn / (2 * np.pi), 4)
    v = np.concatenate(
        [np.repeat([0.05, 0.1, 0.2, 0.25], 25), np.repeat([0.45, 0.5, 0.6, 0.97], 25)]
    )
    texture = np.zeros((64, 64, 3), np.uint8)
    texture[:] = np.rint(
        255 * rgb(PALETTE[str(rng.choice(["black", "brown", "charcoal", "navy"]))])
    )
    texture[26:38] = (178, 176, 170)
    texture[38:] = (24, 26, 30) if rng.uniform() < 0.6 else (232, 230, 224)
    faces = np.concatenate([ring_faces(4, 24), ring_faces(4, 24) + 100])
    return _rigid(
        "watch", vertices, faces, np.stack([u.tolist() * 2, v], 1), texture, "l_forearm", 0.5
    ), (np.zeros(len(body.vertices), bool))


def glasses(body: BareBody, chart: Chart, rng: np.random.Generator) -> Worn:
    """Rims before the eyes, a bridge and temples; the lenses are clear."""
    shape, skull = anatomy(), skull_of(body)
    eyes = []
    for side in ("eye_front.L", "eye_front.R"):
        eye = body.vertices[np.unique(shape.faces[shape.region == REGIONS.index(side)])]
        eyes.append(np.array([eye[:, 0].max(), eye[:, 1].mean(), eye[:, 2].mean()]))
    ahead = max(e[0] for e in eyes) + EYE_FORWARD
    half = np.array([rng.uniform(0.022, 0.026), rng.uniform(0.016, 0.023)])
    power = rng.uniform(2.0, 3.5)  # 2 is round, more is squarer
    turn = np.linspace(0, 2 * np.pi, 25)
    c, s = np.cos(turn), np.sin(turn)
    outline = np.stack(
        [np.sign(c) * np.abs(c) ** (2 / power), np.sign(s) * np.abs(s) ** (2 / power)], 1
    )
    tubes = []
    for eye in eyes:
        loop = np.column_stack([np.full(25, ahead), outline * half + eye[1:] - [0, 0.003]])
        loop[:, 0] -= 0.25 * np.abs(loop[:, 1]) ** 2 / 0.05  # wrapped a little around the face
        tubes.append(loop)
    inner = [eyes[0][1] - half[0], eyes[1][1] + half[0]]
    y = np.linspace(inner[0], inner[1], 7)
    z = eyes[0][2] + 0.004 + 0.004 * np.cos(np.linspace(-1.5, 1.5, 7))
    tubes.append(np.column_stack([np.full(7, ahead), y, z]))
    for sign, eye in zip((1, -1), eyes, strict=True):
        hinge = np.array(
            [
                ahead - 0.25 * (abs(eye[1]) + half[0]) ** 2 / 0.05,
                eye[1] + sign * half[0],
                eye[2] + 0.006,
            ]
        )
        ear = np.array([skull.centre[0] - 0.015, sign * (skull.half[1] + 0.006), eye[2] + 0.004])
        tubes.append(
            np.array(
                [hinge, hinge * [1, 0, 1] + [-0.008, ear[1], 0], ear, ear + [-0.025, 0, -0.022]]
            )
        )
    thick = rng.uniform(0.0011, 0.0024)
    vertices, faces, count = [], [], 0
    for tube in tubes:
        vertices.append(_tube_around(tube, thick))
        faces.append(ring_faces(len(tube), 4) + count)
        count += len(vertices[-1])
    vertices = np.concatenate(vertices)
    texture = np.zeros((8, 8, 3), np.uint8)
    texture[:] = np.rint(255 * rgb(PALETTE[str(rng.choice(FRAME_COLORS))]))
    uv = np.full((len(vertices), 2), 0.5)
    return _rigid("glasses", vertices, np.concatenate(faces), uv, texture, "head", 0.5), np.zeros(
        len(body.vertices), bool
    )


def cap(body: BareBody, chart: Chart, rng: np.random.Generator) -> Worn:
    """A cap with a peak over the eyes."""
    return _hat(
        "cap",
        body,
        rng,
        brim=lambda turn: 0.075 * np.clip(1.6 * np.cos(turn) - 0.6, 0, 1) ** 0.5,
        crown=1.0,
    )


def sun_hat(body: BareBody, chart: Chart, rng: np.random.Generator) -> Worn:
    """A hat with a wide brim all around."""
    return _hat("hat", body, rng, brim=lambda turn: 0.085 + 0 * turn, crown=1.12)


def beanie(body: BareBody, chart: Chart, rng: np.random.Generator) -> Worn:
    """A knitted cap without a brim."""
    return _hat("beanie", body, rng, brim=lambda turn: 0 * turn, crown=1.10, pattern="knit")


def _hat(
    name: str,
    body: BareBody,
    rng: np.random.Generator,
    brim: Callable[[Array], Array],
    crown: float,
    pattern: str = "plain",
) -> Worn:
    """A dome around the skull and hair, and a brim of some width (m) by direction (0 ahead)."""
    skull, around, rings = skull_of(body), 40, 8
    turn = np.linspace(0, 2 * np.pi, around + 1)
    half = skull.half + [0.020, 0.018, 0.022]
    points = []
    for angle in np.linspace(0.02, np.pi / 2, rings):
        ring = np.stack([np.cos(turn), np.sin(turn)], 1) * np.sin(angle) ** 0.8
        points.append(
            np.column_stack([ring * half[:2], np.full(around + 1, crown * half[2] * np.cos(angle))])
        )
    width = brim(turn)
    rim = points[-1]
    out = np.column_stack([np.cos(turn), np.sin(turn), np.full(around + 1, -0.22)]) * width[:, None]
    points += [
        rim + 0.5 * out,
        rim + out,
        rim + out - [0, 0, 0.003],
        rim * [0.97, 0.97, 1] - [0, 0, 0.004],
    ]
    vertices = np.concatenate(points) + skull.centre + [0, 0, 0.12 * skull.half[2]]
    cloth = one_color(pattern, str(rng.choice(list(PALETTE))))
    texture = np.tile(fabric_texture(cloth, rng), (2, 2, 1))
    texture[: len(texture) // 16] = np.clip(texture[: len(texture) // 16] * 0.7, 0, 255)
    rows = np.append(np.linspace(0.02, 0.8, rings), [0.9, 0.97, 0.98, 0.99])
    uv = np.stack([np.tile(turn / np.pi, len(rows)), np.repeat(rows, around + 1)], 1)
    head = anatomy().owner == INDEX["head"]
    hidden = head & (body.vertices[:, 2] > skull.centre[2] + 0.35 * skull.half[2])
    return _rigid(name, vertices, ring_faces(len(rows), around), uv, texture, "head", 0.05), hidden


def _back_of_hand(body: BareBody) -> Float[Array, "3"]:
    """Direction of the back of the left hand: away from where thumb and fingers bend."""
    hand = body.vertices[anatomy().owner == INDEX["l_hand"]]
    flat = np.linalg.svd(hand - hand.mean(0), full_matrices=False)[2][2]
    return flat if flat @ [0.2, 1.0, 0.6] > 0 else -flat


def _tube_around(path: Float[Array, "R 3"], radius: float) -> Float[Array, "RV 3"]:
    """Points of a four-sided tube around a line."""
    along = unit(np.gradient(path, axis=0))
    side = unit(np.cross(along, [0.35, 0.2, 0.91]))
    up = np.cross(side, along)
    turn = np.linspace(0, 2 * np.pi, 5)
    ring = np.cos(turn)[:, None, None] * side + np.sin(turn)[:, None, None] * up
    return (path + radius * ring).transpose(1, 0, 2).reshape(-1, 3)


def _rigid(
    name: str, vertices: Array, faces: Array, uv: Array, texture: Array, body: str, shininess: float
) -> Mesh:
    """A mesh that moves with one body."""
    bones = np.zeros((len(vertices), 4), np.int32)
    bones[:, 0] = INDEX[body]
    return Mesh(
        name=name,
        vertices=vertices,
        faces=faces,
        uv=uv,
        texture=texture,
        parts=PART_OF_BODY[bones[:, 0]],
        bones=bones,
        weights=np.tile([1.0, 0.0, 0.0, 0.0], (len(vertices), 1)),
        shininess=shininess,
        double_sided=True,
    )


ACCESSORIES: dict[str, dict[str, Fit]] = {
    "gloves": {"gloves": gloves},
    "watch": {"watch": watch},
    "glasses": {"glasses": glasses},
    "hat": {"cap": cap, "sun_hat": sun_hat, "beanie": beanie},
}
"""What may be worn beside clothes, by the part of the outfit it fills; 'none' fills none."""
