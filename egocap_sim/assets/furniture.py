"""Furniture from boxes, cylinders and balls, in realistic sizes.

Every function returns meshes that stand on z = 0 with their back at y = 0 and extend into +y,
centred on x = 0; `egocap_sim.environment.rooms` places them against a wall.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import product

import numpy as np

from egocap_sim.assets import textures
from egocap_sim.assets.mesh import Material, Mesh
from egocap_sim.assets.primitives import ball, box, cylinder, placed, sheet

Rng = np.random.Generator


def legs(
    name: str,
    x: Iterable[float],
    y: Iterable[float],
    size: tuple[float, float, float],
    material: Material,
    z: float | None = None,
) -> list[Mesh]:
    """Boxes of one size at all pairs of x and y, on the floor or centred at height z."""
    height = size[2] / 2 if z is None else z
    return [box(name, (*at, height), size, material) for at in product(x, y)]


def table(rng: Rng) -> list[Mesh]:
    """A table with books and cups on it."""
    w, d, h = rng.uniform(1.1, 1.7), rng.uniform(0.65, 0.8), rng.uniform(0.70, 0.76)
    top = _hard(rng)
    out = [box("table top", (0, d / 2, h - 0.02), (w, d, 0.04), replace(top, shininess=0.2))]
    half = w / 2 - 0.06
    out += legs(
        "table leg", (-half, half), (0.05, d - 0.05), (0.06, 0.06, h - 0.04), top, h / 2 - 0.02
    )
    for _ in range(int(rng.integers(1, 4))):
        x, y = rng.uniform(-w / 2 + 0.2, w / 2 - 0.2), rng.uniform(0.15, d - 0.15)
        paint = textures.lacquer(rng)
        if rng.random() < 0.5:
            size = (rng.uniform(0.15, 0.3), rng.uniform(0.1, 0.22), rng.uniform(0.02, 0.12))
            out.append(box("book", (x, y, h + size[2] / 2), size, paint))
        else:
            r = rng.uniform(0.035, 0.06)
            out.append(cylinder("cup", (x, y, h), (0.8 * r, r), 2.2 * r, paint, sides=14))
    return out


def chair(rng: Rng) -> list[Mesh]:
    """A plain chair, its back to the wall."""
    s, h = rng.uniform(0.40, 0.46), 0.45
    frame, seat = _hard(rng), textures.cloth(rng)
    out = [box("seat", (0, s / 2 + 0.03, h - 0.025), (s, s, 0.05), seat)]
    for x in (-1, 1):
        at = x * (s / 2 - 0.02)
        out.append(box("chair leg", (at, s, h / 2 - 0.025), (0.04, 0.04, h - 0.05), frame))
        out.append(box("chair post", (at, 0.03, 0.45), (0.04, 0.04, 0.9), frame))
    back = (s - 0.08, 0.025, rng.uniform(0.12, 0.3))
    return [*out, box("chair back", (0, 0.03, 0.9 - back[2] / 2), back, frame)]


def shelf(rng: Rng) -> list[Mesh]:
    """Open shelves with rows of books."""
    w, d, h = rng.uniform(0.7, 1.4), rng.uniform(0.28, 0.36), rng.uniform(1.2, 2.1)
    wood, side = _hard(rng), w / 2 - 0.01
    out = [box("shelf back", (0, 0.01, h / 2), (w, 0.02, h), wood)]
    out += legs("shelf side", (-side, side), (d / 2,), (0.02, d, h), wood)
    spines, paper = replace(textures.books(rng), part=101), textures.even(0.75)
    for z in np.linspace(0.06, h - 0.01, int(h / 0.36) + 1):
        out.append(box("board", (0, d / 2, z), (w, d, 0.02), wood))
        if z < h - 0.3:
            length, tall = (w - 0.04) * rng.uniform(0.4, 1.0), rng.uniform(0.2, 0.28)
            left = -w / 2 + 0.02 + (w - 0.04 - length) * rng.random()
            corner = (left + length, d - 0.05, z + tall)
            out.append(sheet("books", corner, (-length, 0, 0), (0, 0, -tall), spines))
            middle = (left + length / 2, d / 2 - 0.02, z + tall / 2 - 0.01)
            out.append(box("pages", middle, (length, d - 0.07, tall - 0.02), paper))
    return out


def cupboard(rng: Rng) -> list[Mesh]:
    """A chest or wardrobe with two doors."""
    w, d, h = rng.uniform(0.8, 1.5), rng.uniform(0.4, 0.55), rng.choice([0.8, 0.95, 1.9])
    wood, knob = _hard(rng), replace(textures.even(0.7), shininess=0.4)
    out = [box("cupboard", (0, d / 2, h / 2), (w, d, h), replace(wood, shininess=0.1))]
    for x in (-1, 1):
        out.append(box("door", (x * w / 4, d + 0.009, h / 2), (w / 2 - 0.03, 0.018, h - 0.1), wood))
        out.append(box("knob", (x * 0.04, d + 0.025, h * 0.55), (0.02, 0.03, 0.1), knob))
    return out


def sofa(rng: Rng) -> list[Mesh]:
    """A sofa with cushions."""
    w, d = rng.uniform(1.5, 2.1), rng.uniform(0.75, 0.8)
    cloth = textures.cloth(rng)
    out = [
        box("sofa base", (0, d / 2, 0.14), (w, d, 0.22), cloth),
        box("sofa back", (0, 0.1, 0.48), (w, 0.2, 0.62), cloth),
        *legs("arm", (-(w / 2 - 0.09), w / 2 - 0.09), (d / 2,), (0.18, d, 0.44), cloth, 0.36),
    ]
    count, inner = int(rng.integers(2, 4)), w - 0.36
    for k in range(count):
        x = -inner / 2 + inner * (k + 0.5) / count
        size = (inner / count - 0.015, d - 0.22, 0.16)
        out.append(box("cushion", (x, d / 2 + 0.1, 0.34), size, cloth))
    other = textures.cloth(rng)
    at = (rng.choice([-1, 1]) * (inner / 2 - 0.2), 0.27, 0.56)
    return [*out, ball("pillow", at, (0.2, 0.08, 0.18), other, rings=8)]


def plant(rng: Rng) -> list[Mesh]:
    """A pot plant."""
    r, h = rng.uniform(0.14, 0.2), rng.uniform(0.5, 1.1)
    pot, leaf = textures.lacquer(rng), textures.leaves(rng)
    bark = textures.even((0.35, 0.25, 0.18))
    out = [
        cylinder("pot", (0, 0.3, 0), (0.75 * r, r), 1.7 * r, replace(pot, shininess=0.3)),
        cylinder("stem", (0, 0.3, r), 0.02, h, bark, sides=8),
    ]
    for _ in range(int(rng.integers(6, 11))):
        at = np.array([0, 0.3, r + h * rng.uniform(0.55, 1.0)]) + rng.normal(0, 0.07, 3)
        radii = rng.uniform(0.09, 0.2, 3)
        at[1] = max(at[1], radii[1])
        out.append(ball("leaves", at, radii, leaf, rings=7))
    return out


def boxes(rng: Rng) -> list[Mesh]:
    """Cardboard boxes, stacked."""
    card = np.array([0.66, 0.52, 0.36]) * rng.uniform(0.85, 1.1)
    texture = np.clip(card * 255 * (1 + 0.04 * textures.noise(rng, 2, 60))[..., None], 0, 255)
    paper = Material(texture.astype(np.uint8), 0.8)
    out, z = [], 0.0
    for _ in range(int(rng.integers(1, 4))):
        size = rng.uniform([0.35, 0.3, 0.2], [0.6, 0.45, 0.4])
        one = box("carton", (0, 0, size[2] / 2), size, paper)
        out += placed([one], (rng.uniform(-0.04, 0.04), 0.4, z), rng.uniform(-0.3, 0.3))
        z += float(size[2])
    return out


def floor_lamp(rng: Rng) -> list[Mesh]:
    """A standing lamp with a lit shade."""
    h = rng.uniform(1.4, 1.7)
    metal, shade = textures.even(0.3), replace(textures.even((1.0, 0.95, 0.84)), glows=True)
    return [
        cylinder("lamp foot", (0, 0.3, 0), 0.14, 0.03, replace(metal, shininess=0.4)),
        cylinder("lamp pole", (0, 0.3, 0.03), 0.012, h, metal, sides=8),
        cylinder("lamp shade", (0, 0.3, h - 0.15), (0.19, 0.13), 0.26, shade),
    ]


WALL_PIECES: tuple[Callable[[Rng], list[Mesh]], ...] = (
    table, chair, shelf, cupboard, sofa, plant, boxes, floor_lamp,
)  # fmt: skip


def _hard(rng: Rng) -> Material:
    return textures.wood(rng) if rng.random() < 0.7 else textures.lacquer(rng)
