"""Handheld props, fixed to the palm."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from egocap.geometry import rigid, unit
from egocap_sim.assets import textures
from egocap_sim.assets.mesh import AnimatedActor, Material, Mesh, moving
from egocap_sim.assets.primitives import box, cylinder, sheet
from egocap_sim.core.bodies import INDEX
from egocap_sim.core.part_labels import OBJECT
from egocap_sim.props.performance import Performance

_CUP_R, _CUP_H = 0.038, 0.09  # metres
_PAPER = (0.46, 0.34)


def phone(performance: Performance, rng: np.random.Generator, hand: int) -> AnimatedActor:
    """A phone in the palm, its screen facing away from it."""
    size = np.array([rng.uniform(0.07, 0.078), rng.uniform(0.14, 0.16), 0.008])
    case = replace(textures.even(rng.uniform(0.05, 0.6, 3)), part=OBJECT, shininess=0.3)
    lit = replace(textures.picture(rng), part=OBJECT, glows=True)
    w, h = 0.92 * size[0], 0.92 * size[1]
    screen = sheet("screen", (-w / 2, h / 2, 0.0085), (w, 0, 0), (0, -h, 0), lit)
    return _in_hand("phone", [box("phone", (0, 0, 0.004), size, case), screen], performance, hand)


def cup(performance: Performance, rng: np.random.Generator, hand: int) -> AnimatedActor:
    """A cup in the palm, its opening on the side of the thumb."""
    glaze = replace(textures.even(rng.uniform(0.2, 0.95, 3)), part=OBJECT, shininess=0.4)
    tea = replace(textures.even((0.25, 0.13, 0.06)), part=OBJECT)
    body = cylinder("cup", (0, 0, -_CUP_H / 2), (0.85 * _CUP_R, _CUP_R), _CUP_H, glaze)
    top = cylinder("tea", (0, 0, _CUP_H / 2), 0.9 * _CUP_R, 0.001, tea)
    return _in_hand("cup", [body, top], performance, hand, away=_CUP_R, upright=True)


def newspaper(performance: Performance, rng: np.random.Generator) -> list[AnimatedActor]:
    """An open newspaper between both hands, facing the head."""
    w, h = _PAPER
    print_ = Material(_print(rng), part=OBJECT)
    front = sheet("page", (-w / 2, h / 2, 0.001), (w, 0, 0), (0, -h, 0), print_)
    print_ = replace(print_, casts_shadow=True)
    back = sheet("page", (w / 2, h / 2, -0.001), (-w, 0, 0), (0, -h, 0), print_)
    left, right = performance.palm_paths
    head = performance.bodies[:, INDEX["head"], :3, 3]
    middle, x = (left + right) / 2, unit(right - left)  # x of the page, seen from the head
    towards = head - middle
    z = unit(towards - (towards * x).sum(1, keepdims=True) * x)
    pose = rigid(np.stack([x, np.cross(z, x), z], -1), middle)
    return [moving("newspaper", [(0, front), (0, back)], pose[:, None])]


def _in_hand(
    name: str,
    meshes: Iterable[Mesh],
    performance: Performance,
    hand: int,
    *,
    away: float = 0.0,
    upright: bool = False,
) -> AnimatedActor:
    """Meshes `away` metres off a palm: y to the fingertips, z the palm's normal.

    With `upright`, y is the palm's normal and z points to the thumb.
    """
    palm = performance.palms[hand]
    z, y = (palm.thumb, palm.normal) if upright else (palm.normal, palm.fingers)
    y = unit(y - (y @ z) * z)
    local = rigid(np.stack([np.cross(y, z), y, z], -1), palm.centre + away * palm.normal)
    pose = (performance.bodies[:, palm.body] @ local)[:, None]
    return moving(name, [(0, m) for m in meshes], pose)


def _print(rng: np.random.Generator) -> UInt8[Array, "256 352 3"]:
    """Columns of grey lines, headlines and a picture."""
    page = np.full((256, 352, 3), 0.86)
    for x in range(12, 348, 84):
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
    return textures.to_bytes(page)
