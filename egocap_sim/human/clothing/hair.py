"""Hair: a shell over the scalp, and locks that fall over the back, the shoulders and the chest."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from egocap.geometry import unit
from egocap_sim.assets.mesh import Mesh
from egocap_sim.core.bodies import BODIES, INDEX
from egocap_sim.human.body.anny_model import BareBody, anatomy
from egocap_sim.human.body.body_chart import Chart
from egocap_sim.human.body.noise import smooth_noise
from egocap_sim.human.body.skin import PART_OF_BODY
from egocap_sim.human.body.skull import Skull, skull_of
from egocap_sim.human.clothing.fabric import TILE_M
from egocap_sim.human.clothing.sewing import sew, strongest
from egocap_sim.human.clothing.shell import Cut, Shell, make_shell
from egocap_sim.human.clothing.tailoring import Cloth


@dataclass(frozen=True)
class Hair:
    """A haircut: thickness (m) on top and at its edge, how far down the nape it reaches (m)."""

    top: float
    edge: float
    nape: float
    fall: float = 0.0  # m below the skull's middle that locks fall
    front: bool = False  # locks fall before the shoulders too
    tail: bool = False  # one lock behind, bound


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
FLAT = {"helmet": 0.012, "headset": 0.018}  # m of hair that headgear leaves on top
ROWS, SIDES = 9, 6  # of a lock
CLEAR = 0.022  # m between the skin and the middle of a lock: room for cloth


def make_hair(
    body: BareBody,
    chart: Chart,
    hair: Hair | None,
    color: Float[Array, "3"],
    headgear: str | None,
    rng: np.random.Generator,
) -> tuple[list[Mesh], Bool[Array, "N"]]:
    """Hair over the scalp with its locks, and the skin it hides."""
    if hair is None:
        return [], np.zeros(len(body.vertices), bool)
    if headgear is not None:
        hair = replace(hair, top=min(hair.top, FLAT[headgear]))
    texture = hair_texture(color, rng)
    shell, hidden = fit_hair(body, chart, hair)
    meshes = [sew("hair", shell, body, Cloth(texture, TILE_M, rng, 0), 0.2)]
    if hair.fall:
        meshes.append(_locks(body, hair, texture, rng))
    return meshes, hidden


def fit_hair(body: BareBody, chart: Chart, hair: Hair) -> tuple[Shell, Bool[Array, "N"]]:
    """Hair over the scalp, and the skin it hides; it goes round the ears.

    The hairline is high on the forehead, runs down before the ears, and is low at the nape.
    """
    skull = skull_of(body)
    x, y, z = (body.vertices - skull.centre).T / skull.half[:, None]
    line = np.interp(x, [-1.0, -0.2, 0.15, 0.55, 1.0], [-0.75, -0.6, -0.15, 0.42, 0.56])
    line = skull.half[2] * line - np.where(x < 0.1, hair.nape * np.clip(0.6 - x, 0, 1), 0)
    inside = body.vertices[:, 2] - skull.centre[2] - line
    around = np.linalg.norm((np.stack([x, z], 1) - EAR) * skull.half[[0, 2]], axis=1)
    inside = np.where(np.abs(y) > 0.6, np.minimum(inside, around - 0.036), inside)
    on_head = np.isin(anatomy().owner, [INDEX["head"], INDEX["neck"]])
    cut = Cut([np.where(on_head, inside, -1.0)], margin=0.02)
    rise = np.clip(inside / 0.05, 0, 1)
    shell = make_shell(
        body,
        chart,
        cut,
        np.full(len(x), hair.edge * 0.5 + 0.001),
        hair.edge / 2 + (hair.top - hair.edge) * rise,
        rounds=40,
    )
    return shell, cut.covered(body.vertices)


def hair_texture(color: Float[Array, "3"], rng: np.random.Generator) -> UInt8[Array, "128 128 3"]:
    """Strands running down the head."""
    strands = 0.3 * smooth_noise(128, (3, 64), rng) + 0.15 * smooth_noise(128, (2, 16), rng)
    return np.rint(np.clip(color * (1 + strands[..., None]), 0, 1) * 255).astype(np.uint8)


def _locks(
    body: BareBody, hair: Hair, texture: UInt8[Array, "H W 3"], rng: np.random.Generator
) -> Mesh:
    """Flat tubes that start on the scalp and lie on the body below it."""
    skull = skull_of(body)
    if hair.tail:
        starts = [(np.pi, 0.030, 0.026)]
    else:
        behind = np.linspace(np.radians(96), np.radians(264), 9)
        starts = [(a, 0.030, 0.011) for a in behind]
        if hair.front:
            starts += [(s * np.radians(a), 0.026, 0.010) for s in (1, -1) for a in (62, 82)]
    vertices, faces, uv, weights = [], [], [], []
    for i, (angle, wide, thick) in enumerate(starts):
        length = hair.fall * rng.uniform(0.88, 1.0)
        path = _path(body, skull, angle, length, hair)
        taper = np.sin(np.pi * np.clip(np.linspace(0.25, 0.93, ROWS), 0, 1)) ** 0.5
        outward = unit(path - skull.centre * [1, 1, 0] - path * [0, 0, 1])
        across = unit(np.cross(outward, np.gradient(path, axis=0)))
        turn = 2 * np.pi * np.arange(SIDES + 1) / SIDES
        ring = (
            path[:, None]
            + across[:, None] * (wide * taper[:, None] * np.cos(turn))[..., None]
            + outward[:, None] * (thick * taper[:, None] * np.sin(turn))[..., None]
        )
        vertices.append(ring.reshape(-1, 3))
        faces.append(_tube(ROWS, SIDES) + i * ROWS * (SIDES + 1))
        rows = np.repeat(np.arange(ROWS) / ROWS, SIDES + 1)
        uv.append(np.stack([np.tile(turn / 12 + 0.37 * i, ROWS), rows], 1))
        weights.append(np.repeat(_hold(body, path, hair), SIDES + 1, axis=0))
    bones, kept = strongest(np.concatenate(weights))
    return Mesh(
        name="locks",
        vertices=np.concatenate(vertices),
        faces=np.concatenate(faces).astype(np.int32),
        uv=np.concatenate(uv),
        texture=texture,
        parts=PART_OF_BODY[bones[:, 0]],
        bones=bones,
        weights=kept,
        shininess=0.2,
        double_sided=True,
    )


def _path(
    body: BareBody, skull: Skull, angle: float, length: float, hair: Hair
) -> Float[Array, "R 3"]:
    """The middle line of a lock: from the scalp down, outside head, neck and shoulders."""
    along = np.array([np.cos(angle), np.sin(angle)])
    share = np.linspace(0, 1, ROWS)
    start = 0.35 if not hair.tail else 0.1
    z = skull.centre[2] + start * skull.half[2] - share * (length + start * skull.half[2])
    reach = skull.half[:2] * (0.97 if not hair.tail else 1.25)
    path = np.column_stack([skull.centre[:2] + along * reach + np.zeros((ROWS, 2)), z])
    # Below the ears hair gathers: locks at the sides go before or behind the shoulders.
    gather = np.clip((skull.centre[2] - 0.3 * skull.half[2] - z) / 0.16, 0, 1)
    ahead = np.cos(angle) > 0
    side = np.sin(angle) * (0.095 if ahead else 0.085)
    path[:, 1] += gather * (side - path[:, 1])
    path[:, 0] += gather * ((0.055 if ahead else -0.055) + skull.centre[0] * 0 - along[0] * 0.02)
    skin = body.vertices[anatomy().owner != INDEX["head"]]
    sign = 1.0 if ahead else -1.0
    for i in range(ROWS):
        near = (np.abs(skin[:, 1] - path[i, 1]) < 0.035) & (np.abs(skin[:, 2] - path[i, 2]) < 0.03)
        if near.any():
            surface = (sign * skin[near, 0]).max() + CLEAR
            path[i, 0] = sign * max(sign * path[i, 0], surface)
    for _ in range(2):
        path[1:-1] = 0.5 * path[1:-1] + 0.25 * (path[:-2] + path[2:])
    return path


def _hold(body: BareBody, path: Float[Array, "R 3"], hair: Hair) -> Float[Array, "R 21"]:
    """Locks follow the head above the chin and the chest where they lie on it."""
    chest = body.joints[INDEX["neck"], 2]
    share = np.clip((chest + 0.09 - path[:, 2]) / 0.14, 0, 1) * (0.5 if hair.tail else 1.0)
    weights = np.zeros((len(path), len(BODIES)))
    weights[:, INDEX["head"]] = 1 - share
    weights[:, INDEX["chest"]] = share
    return weights


def _tube(rows: int, sides: int) -> Array:
    ring = np.arange(sides)
    strips = []
    for i in range(rows - 1):
        a, b = i * (sides + 1), (i + 1) * (sides + 1)
        strips.append(np.stack([a + ring, b + ring, b + ring + 1], 1))
        strips.append(np.stack([a + ring, b + ring + 1, a + ring + 1], 1))
    return np.concatenate(strips)
