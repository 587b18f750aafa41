"""Hair: a shell over the scalp, and locks that hang over the back, the shoulders and the chest."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.geometry import unit
from egocap_sim.assets.mesh import Mesh
from egocap_sim.assets.textures import to_bytes
from egocap_sim.core.bodies import BODIES, INDEX
from egocap_sim.human.body.anny_model import anatomy
from egocap_sim.human.body.body_chart import BodyChart
from egocap_sim.human.body.noise import smooth_noise
from egocap_sim.human.body.skinning import Worn, skinned_mesh
from egocap_sim.human.body.triangles import ring_faces
from egocap_sim.human.clothing.fabric import TILE_M
from egocap_sim.human.clothing.shell import Pattern, Shell, make_shell
from egocap_sim.human.clothing.tailoring import Cloth, sew


@dataclass(frozen=True)
class Hair:
    """A haircut: thickness (m) on top and at its edge, how far down the nape it reaches (m)."""

    top: float
    edge: float
    nape: float
    fall: float = 0.0  # length (m) of locks below the middle of the skull; 0 for none
    front: bool = False  # locks hang in front of the shoulders too
    tail: bool = False  # one bound lock behind


HAIRCUTS: dict[str, Hair | None] = {
    "bald": None,
    "buzz": Hair(0.004, 0.002, 0.02),
    "short": Hair(0.014, 0.004, 0.03),
    "thick": Hair(0.028, 0.010, 0.03),
    "bob": Hair(0.020, 0.012, 0.03, fall=0.13),
    "long": Hair(0.018, 0.012, 0.03, fall=0.36, front=True),
    "very_long": Hair(0.018, 0.012, 0.03, fall=0.50, front=True),
    "ponytail": Hair(0.010, 0.004, 0.03, fall=0.30, tail=True),
}
HAIR_COLORS: dict[str, str] = {
    "black": "#17130f", "dark brown": "#2e1f16", "brown": "#4f3522", "light brown": "#7a5a3a",
    "blond": "#b08f5c", "red": "#7d3b1f", "grey": "#86837e", "white": "#cfcbc4",
}  # fmt: skip
EAR = (-0.1, -0.45)  # middle of the ears, forward and up, in halves of the skull
FLAT = {"helmet": 0.012, "headset": 0.018}  # m, largest thickness under headgear
ROWS, SIDES = 9, 6  # of a lock
CLEAR = 0.022  # m between the skin and the middle of a lock; leaves room for cloth


def make_hair(
    chart: BodyChart,
    hair: Hair,
    color: Float[Array, "3"],
    headgear: str | None,
    rng: np.random.Generator,
) -> list[Worn]:
    """Hair over the scalp, flattened by headgear, and its locks."""
    if headgear is not None:
        hair = replace(hair, top=min(hair.top, FLAT[headgear]))
    texture = hair_texture(color, rng)
    scalp = sew("hair", fit_hair(chart, hair), chart.body, Cloth(texture, TILE_M, rng, 0), 0.2)
    if not hair.fall:
        return [scalp]
    return [scalp, Worn(_locks(chart, hair, texture, rng), scalp.hidden)]


def fit_hair(chart: BodyChart, hair: Hair) -> Shell:
    """Hair over the scalp; the ears stay free.

    The hairline is high on the forehead, descends in front of the ears, and is low at the nape.
    """
    skull = chart.skull
    x, y, z = (chart.vertices - skull.centre).T / skull.half[:, None]
    line = np.interp(x, [-1.0, -0.2, 0.15, 0.55, 1.0], [-0.75, -0.6, -0.15, 0.42, 0.56])
    line = skull.half[2] * line - np.where(x < 0.1, hair.nape * np.clip(0.6 - x, 0, 1), 0)
    inside = chart.vertices[:, 2] - skull.centre[2] - line
    around = np.linalg.norm((np.stack([x, z], 1) - EAR) * skull.half[[0, 2]], axis=1)
    inside = np.where(np.abs(y) > 0.6, np.minimum(inside, around - 0.036), inside)
    on_head = np.isin(anatomy().owner, [INDEX["head"], INDEX["neck"]])
    pattern = Pattern(
        [np.where(on_head, inside, -1.0)],
        gap=np.full(len(x), hair.edge * 0.5 + 0.001),
        looseness=hair.edge / 2 + (hair.top - hair.edge) * np.clip(inside / 0.05, 0, 1),
        margin=0.02,
        rounds=40,
    )
    return make_shell(chart, pattern)


def hair_texture(color: Float[Array, "3"], rng: np.random.Generator) -> UInt8[Array, "128 128 3"]:
    """Strands running down the head."""
    strands = 0.3 * smooth_noise(128, (3, 64), rng) + 0.15 * smooth_noise(128, (2, 16), rng)
    return to_bytes(color * (1 + strands[..., None]))


def _locks(
    chart: BodyChart, hair: Hair, texture: UInt8[Array, "H W 3"], rng: np.random.Generator
) -> Mesh:
    """Flat tubes from the scalp downward, outside the body."""
    centre = chart.skull.centre
    starts = [(np.pi, 0.030, 0.026)]  # angle, half the width and the thickness
    if not hair.tail:
        behind = np.linspace(np.radians(96), np.radians(264), 9)
        starts = [(a, 0.030, 0.011) for a in behind]
    if hair.front:
        starts += [(s * np.radians(a), 0.026, 0.010) for s in (1, -1) for a in (62, 82)]
    taper = np.sin(np.pi * np.clip(np.linspace(0.25, 0.93, ROWS), 0, 1)) ** 0.5
    turn = 2 * np.pi * np.arange(SIDES + 1) / SIDES
    rows = np.repeat(np.arange(ROWS) / ROWS, SIDES + 1)
    vertices, faces, uv, weights = [], [], [], []
    for i, (angle, wide, thick) in enumerate(starts):
        path = _path(chart, angle, hair.fall * rng.uniform(0.88, 1.0), hair)
        outward = unit(path - centre * [1, 1, 0] - path * [0, 0, 1])
        across = unit(np.cross(outward, np.gradient(path, axis=0)))
        ring = (
            path[:, None]
            + across[:, None] * (wide * taper[:, None] * np.cos(turn))[..., None]
            + outward[:, None] * (thick * taper[:, None] * np.sin(turn))[..., None]
        )
        vertices.append(ring.reshape(-1, 3))
        faces.append(ring_faces(ROWS, SIDES) + i * ROWS * (SIDES + 1))
        uv.append(np.stack([np.tile(turn / 12 + 0.37 * i, ROWS), rows], 1))
        weights.append(np.repeat(_weights(chart, path, hair), SIDES + 1, axis=0))
    points, triangles, places, shares = (np.concatenate(a) for a in (vertices, faces, uv, weights))
    return skinned_mesh("locks", points, triangles, places, texture, shares, 0.2)


def _path(chart: BodyChart, angle: float, length: float, hair: Hair) -> Float[Array, "R 3"]:
    """Centre line of a lock: from the scalp down, outside head, neck and shoulders."""
    skull, along = chart.skull, np.array([np.cos(angle), np.sin(angle)])
    share = np.linspace(0, 1, ROWS)
    start, scale = (0.1, 1.25) if hair.tail else (0.35, 0.97)
    z = skull.centre[2] + start * skull.half[2] - share * (length + start * skull.half[2])
    reach = skull.half[:2] * scale
    path = np.column_stack([skull.centre[:2] + along * reach + np.zeros((ROWS, 2)), z])
    # Below the ears, locks at the sides move to the front or the back of the shoulders.
    gather = np.clip((skull.centre[2] - 0.3 * skull.half[2] - z) / 0.16, 0, 1)
    sign, side, away = (1.0, 0.095, 0.055) if np.cos(angle) > 0 else (-1.0, 0.085, -0.055)
    path[:, 1] += gather * (np.sin(angle) * side - path[:, 1])
    path[:, 0] += gather * (away - along[0] * 0.02)
    skin = chart.vertices[anatomy().owner != INDEX["head"]]
    for i in range(ROWS):
        near = (np.abs(skin[:, 1] - path[i, 1]) < 0.035) & (np.abs(skin[:, 2] - path[i, 2]) < 0.03)
        if near.any():
            surface = (sign * skin[near, 0]).max() + CLEAR
            path[i, 0] = sign * max(sign * path[i, 0], surface)
    for _ in range(2):
        path[1:-1] = 0.5 * path[1:-1] + 0.25 * (path[:-2] + path[2:])
    return path


def _weights(chart: BodyChart, path: Float[Array, "R 3"], hair: Hair) -> Float[Array, "R 21"]:
    """Locks follow the head above the chin and the chest below it."""
    chest = chart.joint("neck")[2]
    share = np.clip((chest + 0.09 - path[:, 2]) / 0.14, 0, 1) * (0.5 if hair.tail else 1.0)
    weights = np.zeros((len(path), len(BODIES)))
    weights[:, INDEX["head"]] = 1 - share
    weights[:, INDEX["chest"]] = share
    return weights
