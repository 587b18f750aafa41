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
from egocap_sim.assets.primitives import box, cylinder, placed, ring, sheet, tube
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


def controller(performance: Performance, rng: np.random.Generator, hand: int) -> AnimatedActor:
    """A game controller in the fist, with a ring above the thumb."""
    shell = replace(textures.even(np.full(3, rng.choice([0.05, 0.85]))), part=OBJECT, shininess=0.3)
    grip = cylinder("grip", (0, 0, -0.06), (0.016, 0.019), 0.11, shell)
    guard = ring("guard", 0.045, 0.006, replace(shell, tile=1.0))
    guard = replace(guard, parts=np.full(len(guard.vertices), OBJECT, np.uint8))
    meshes = [grip, *placed([guard], (0.0, 0.0, 0.085))]
    return _in_hand("controller", meshes, performance, hand, away=0.02, upright=True)


def bag(performance: Performance, rng: np.random.Generator, hand: int) -> AnimatedActor:
    """A shopping bag that hangs from the palm, its broad sides to the left and right."""
    size = np.array([rng.uniform(0.24, 0.36), rng.uniform(0.08, 0.16), rng.uniform(0.26, 0.38)])
    cloth = replace(textures.cloth(rng), part=OBJECT)
    top = -0.16
    body = box("bag", (0, 0, top - size[2] / 2), size, cloth)
    straps = [tube("strap", (0, 0, 0), (x, 0, top), 0.006, cloth) for x in (-0.09, 0.09)]
    x = unit(performance.bodies[:, 0, :3, 0] * [1.0, 1.0, 0.0])  # ahead of the pelvis
    z = np.broadcast_to([0.0, 0.0, 1.0], x.shape)
    pose = rigid(np.stack([x, np.cross(z, x), z], -1), performance.palm_paths[hand])
    return moving("bag", [(0, mesh) for mesh in (body, *straps)], pose[:, None])


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
