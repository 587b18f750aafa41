"""Things in the hand: they lie in the palm wherever it goes."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy import ndarray as Array

from egocap.geometry import rigid, unit
from egocap_sim.assets import textures
from egocap_sim.assets.mesh import AnimatedActor, Mesh
from egocap_sim.assets.primitives import box, cylinder, sheet
from egocap_sim.core import part_labels
from egocap_sim.core.bodies import INDEX
from egocap_sim.props.performance import Performance
from egocap_sim.props.rigid_actor import moving
from egocap_sim.scene.config import ThingTable

_CUP_R, _CUP_H = 0.038, 0.09  # metres
_PAPER = (0.46, 0.34)


def phone(
    thing: ThingTable, performance: Performance, rng: np.random.Generator
) -> list[AnimatedActor]:
    """A phone lying in the palm, its screen away from it."""
    size = np.array([rng.uniform(0.07, 0.078), rng.uniform(0.14, 0.16), 0.008])
    case = textures.even(rng.uniform(0.05, 0.6, 3)).texture
    screen = textures.picture(rng).texture
    meshes = [box("phone", (0, 0, 0.004), size, case, part=part_labels.OBJECT, shininess=0.3)]
    w, h = 0.92 * size[0], 0.92 * size[1]
    meshes.append(
        sheet("screen", (-w / 2, h / 2, 0.0085), (w, 0, 0), (0, -h, 0), screen,
              part=part_labels.OBJECT, glows=True)
    )  # fmt: skip
    return [_in_hand("phone", meshes, performance, _hand(thing), 0.0)]


def cup(
    thing: ThingTable, performance: Performance, rng: np.random.Generator
) -> list[AnimatedActor]:
    """A cup across the palm, its opening on the thumb's side."""
    glaze = textures.even(rng.uniform(0.2, 0.95, 3)).texture
    tea = textures.even(np.array([0.25, 0.13, 0.06])).texture
    body = cylinder(
        "cup", (0, 0, -_CUP_H / 2), (0.85 * _CUP_R, _CUP_R), _CUP_H, glaze, part=part_labels.OBJECT,
        shininess=0.4,
    )  # fmt: skip
    top = cylinder("tea", (0, 0, _CUP_H / 2), 0.9 * _CUP_R, 0.001, tea, part=part_labels.OBJECT)
    return [_in_hand("cup", [body, top], performance, _hand(thing), _CUP_R, upright=True)]


def newspaper(
    thing: ThingTable, performance: Performance, rng: np.random.Generator
) -> list[AnimatedActor]:
    """An open newspaper between both hands, turned to the face."""
    w, h = _PAPER
    print_ = _print(rng)
    front = sheet(
        "page", (-w / 2, h / 2, 0.001), (w, 0, 0), (0, -h, 0), print_, part=part_labels.OBJECT
    )
    back = sheet(
        "page", (w / 2, h / 2, -0.001), (-w, 0, 0), (0, -h, 0), print_, part=part_labels.OBJECT,
        casts_shadow=True,
    )  # fmt: skip
    left, right = (performance.held(k, performance.palms[k].centre) for k in (0, 1))
    head = performance.bodies[:, INDEX["head"], :3, 3]
    middle, x = (left + right) / 2, unit(right - left)  # of a page read from the head's side
    towards = head - middle
    z = unit(towards - (towards * x).sum(1, keepdims=True) * x)
    pose = rigid(np.stack([x, np.cross(z, x), z], -1), middle)
    return [moving("newspaper", [(0, front), (0, back)], pose[:, None])]


def _hand(thing: ThingTable) -> int:
    return int(thing.hand != "left")


def _in_hand(
    name: str,
    meshes: Iterable[Mesh],
    performance: Performance,
    hand: int,
    away: float,
    upright: bool = False,
) -> AnimatedActor:
    """Meshes on a palm, `away` metres off it: their y to the fingertips, z away from the palm; of
    `upright` ones z to the thumb."""
    palm = performance.palms[hand]
    z = palm.thumb if upright else palm.normal
    y = palm.normal if upright else palm.fingers
    y = unit(y - (y @ z) * z)
    local = rigid(np.stack([np.cross(y, z), y, z], -1), palm.centre + away * palm.normal)
    return moving(
        name, [(0, m) for m in meshes], (performance.bodies[:, palm.body] @ local)[:, None]
    )


def _print(rng: np.random.Generator) -> Array:
    """Columns of grey lines, headlines and a picture."""
    page = np.full((256, 352, 3), 0.86)
    for column in range(4):
        x = 12 + column * 84
        y = 12
        while y < 240:
            if rng.random() < 0.08:
                page[y : y + 12, x : x + int(rng.integers(50, 76))] = 0.2
                y += 18
            elif rng.random() < 0.03:
                page[y : y + 50, x : x + 76] = rng.uniform(0.2, 0.7, 3)
                y += 56
            else:
                page[y : y + 2, x : x + int(rng.integers(60, 76))] = 0.45
                y += 5
    return np.round(page * 255).astype(np.uint8)
