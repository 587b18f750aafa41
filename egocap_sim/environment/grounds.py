"""Outdoor places: a yard, a street, a meadow, a court, an open square."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import product

import numpy as np

from egocap import geometry
from egocap_sim.assets import textures
from egocap_sim.assets.mesh import Material, Mesh
from egocap_sim.assets.primitives import ball, box, cylinder, placed, sheet
from egocap_sim.core.part_labels import BACKGROUND, ROOM
from egocap_sim.environment.panorama import dome, make_panorama
from egocap_sim.environment.place import Light, Place, direction, flat, floor

Rng = np.random.Generator


def outdoor(rng: Rng, clear_radius: float) -> Place:
    """A yard or park under the sky: house wall, fence, trees."""
    reach = clear_radius + 14.0
    make_ground = (textures.grass, textures.paving, textures.concrete)[int(rng.integers(3))]
    lawn, yard = textures.grass(rng), make_ground(rng)
    half = clear_radius + 1.5
    meshes = [
        floor(np.full(2, reach), lawn),
        flat("yard", (-half, half, 0.003), (2 * half, 2 * half), yard),
        _sky(rng),
    ]
    brick, bark = replace(textures.bricks(rng), part=ROOM), textures.wood(rng)
    y = clear_radius + rng.uniform(1.5, 3.0)
    meshes.append(box("house", (0, y + 2, 2.5), (12, 4, 5), brick))
    pane = textures.window(rng)
    meshes += [_window(x, y, 2.2, 1.2, pane) for x in (-3.5, -0.5, 3.0)]
    fence = textures.planks(rng)
    at = (0, -clear_radius - rng.uniform(2, 5), 0.6)
    meshes.append(box("fence", at, (16, 0.05, 1.2), fence))
    for _ in range(int(rng.integers(3, 7))):
        angle, r = rng.uniform(-0.9, 0.9) + np.pi * rng.integers(2), reach * rng.uniform(0.5, 0.8)
        meshes += _tree(rng, r * np.cos(angle), r * np.sin(angle), bark)
    return _open_air("outdoor", meshes, rng)


def street(rng: Rng, clear_radius: float) -> Place:
    """A pavement between a row of houses and a road with parked cars, lamps and trees."""
    reach = clear_radius + 14.0
    paving, road = textures.paving(rng), textures.asphalt(rng)
    meshes = [floor(np.full(2, reach), road), _sky(rng)]
    kerb = -clear_radius - rng.uniform(0.3, 1.0)
    front = clear_radius + rng.uniform(0.3, 1.2)
    meshes.append(flat("pavement", (-reach, front, 0.004), (2 * reach, front - kerb), paving))
    x = -reach
    while x < reach:
        width, height = rng.uniform(5, 9), rng.uniform(5, 9)
        meshes += _house(rng, x, front, width, height)
        x += width
    for at in np.arange(-reach + 2, reach - 2, 5.5):
        if rng.random() < 0.6:
            meshes += placed(_car(rng), (at + rng.uniform(-0.4, 0.4), kerb - 1.2, 0.0))
    metal, bark = textures.even(0.25), textures.wood(rng)
    for at in (-6.0, 6.5):
        meshes.append(cylinder("lamp post", (at, kerb - 0.15, 0), 0.06, 4.5, metal, sides=8))
    for at in (-reach * 0.6, reach * 0.55):
        meshes += _tree(rng, at, kerb - 4.0, bark)
    return _open_air("street", meshes, rng)


def square(rng: Rng, clear_radius: float) -> Place:
    """An open square: bollards, and a distant panorama of houses, trees and hills."""
    make_ground = (textures.paving, textures.concrete, textures.asphalt, textures.grass)
    ground = make_ground[int(rng.integers(4))](rng)
    meshes = [floor(np.full(2, clear_radius + 22.0), ground)]
    metal = replace(textures.even(rng.uniform(0.2, 0.5)), shininess=0.3)
    for _ in range(int(rng.integers(0, 5))):
        angle, r = rng.uniform(0, 2 * np.pi), clear_radius + rng.uniform(1.0, 5.0)
        at = (r * np.cos(angle), r * np.sin(angle), 0.0)
        meshes.append(cylinder("bollard", at, 0.07, 0.9, metal, sides=10))
    meshes += dome(make_panorama(rng))
    return _open_air("square", meshes, rng)


def grass(rng: Rng, clear_radius: float) -> Place:
    """A meadow: grass, trees and bushes all around, a path."""
    reach = clear_radius + 16.0
    lawn, path, bark = textures.grass(rng), textures.concrete(rng), textures.wood(rng)
    meshes = [floor(np.full(2, reach), lawn), _sky(rng)]
    y = rng.uniform(-0.5, 0.5) * clear_radius
    meshes.append(flat("path", (-reach, y + 0.7, 0.003), (2 * reach, 1.4), path))
    leaf = textures.leaves(rng)
    for _ in range(int(rng.integers(7, 13))):
        angle, r = rng.uniform(0, 2 * np.pi), clear_radius + rng.uniform(4.5, 12)
        if rng.random() < 0.6:
            meshes += _tree(rng, r * np.cos(angle), r * np.sin(angle), bark)
        else:
            at = (r * np.cos(angle), r * np.sin(angle), 0.5)
            meshes.append(ball("bush", at, rng.uniform(0.6, 1.3, 3), leaf))
    return _open_air("grass", meshes, rng)


def court(rng: Rng, clear_radius: float) -> Place:
    """A sports court outdoors: coloured ground, lines, a basket, a fence."""
    x, y = half = np.array([max(7.0, clear_radius + 2.0), max(5.0, clear_radius + 1.5)])
    paint = textures.even(rng.uniform(0.2, 0.6, 3) * [1.0, 0.9, 0.8])
    rough = 1 + 0.05 * textures.noise(rng, 30, 250, 0.1)[..., None]
    texture = np.clip(paint.texture[0, 0] * rough, 0, 255).astype(np.uint8)
    lawn, white = textures.grass(rng), textures.even(0.92)
    meshes = [floor(half + 12.0, lawn), _sky(rng)]
    meshes.append(flat("court", (-x, y, 0.003), (2 * x, 2 * y), Material(texture, 2.0)))
    for cx, cy, w, d in (
        (0, y - 0.5, 2 * x - 1, 0.06), (0, 0.5 - y, 2 * x - 1, 0.06), (0, 0, 0.06, 2 * y - 1),
        (x - 0.5, 0, 0.06, 2 * y - 1), (0.5 - x, 0, 0.06, 2 * y - 1),
        (x - 3.2, 1.8, 5.4, 0.06), (x - 3.2, -1.8, 5.4, 0.06), (x - 5.9, 0, 0.06, 3.66),
    ):  # fmt: skip
        meshes.append(flat("line", (cx - w / 2, cy + d / 2, 0.006), (w, d), white, tiled=False))
    steel, orange = textures.even(0.35), textures.even((0.85, 0.35, 0.12))
    meshes.append(cylinder("post", (x + 0.6, 0, 0), 0.09, 3.6, steel, sides=10))
    meshes.append(box("board", (x + 0.2, 0, 3.4), (0.05, 1.8, 1.05), white))
    meshes.append(cylinder("basket", (x - 0.05, 0, 3.03), 0.23, 0.03, orange))
    sides = (-y - 1, y + 1)
    for at in product(np.arange(-x - 1, x + 1.1, 2.5), sides):
        meshes.append(cylinder("fence post", (*at, 0), 0.03, 2.2, steel, sides=6))
    for side, z in product(sides, (0.15, 1.1, 2.15)):
        meshes.append(box("rail", (0, side, z), (2 * x + 2, 0.03, 0.03), steel))
    bark = textures.wood(rng)
    for _ in range(5):
        angle = rng.uniform(0, 2 * np.pi)
        r = float(np.hypot(x, y)) + rng.uniform(3.5, 7)
        meshes += _tree(rng, r * np.cos(angle), r * np.sin(angle), bark)
    return _open_air("court", meshes, rng)


def _open_air(name: str, meshes: Iterable[Mesh], rng: Rng) -> Place:
    """A place in daylight, with a random position of the sun."""
    elevation, azimuth = rng.uniform(0.6, 1.2), rng.uniform(0, 2 * np.pi)
    light = Light(
        -direction(azimuth, elevation),
        color=np.array([1.0, 0.95, 0.85]) * rng.uniform(0.6, 0.9),
        sky=np.array([0.34, 0.39, 0.47]),
        ground=np.array([0.13, 0.13, 0.10]),
        sky_axis=geometry.UP,
    )
    return Place(name, tuple(meshes), light, np.array([0.45, 0.6, 0.85]))


def _window(x: float, front: float, top: float, width: float, pane: Material) -> Mesh:
    return sheet("window", (x, front - 0.01, top), (width, 0, 0), (0, 0, -1.3), pane)


def _house(rng: Rng, x: float, front: float, width: float, height: float) -> list[Mesh]:
    """A house along a street: a door and two rows of windows."""
    wall = (textures.bricks, textures.plaster)[int(rng.integers(2))](rng)
    middle = (x + width / 2, front + 3, height / 2)
    out = [box("house", middle, (width, 6, height), replace(wall, part=ROOM))]
    pane, wood = textures.window(rng), replace(textures.wood(rng), part=ROOM)
    for k, at in enumerate(np.arange(x + 0.8, x + width - 1.4, 1.9)):
        if k == 1:
            out.append(box("door", (at + 0.5, front - 0.01, 1.05), (1.0, 0.04, 2.1), wood))
        else:
            out.append(_window(at, front, 2.2, 1.1, pane))
        out.append(_window(at, front, 4.7, 1.1, pane))
    return out


def _car(rng: Rng) -> list[Mesh]:
    """A parked car along x."""
    paint = replace(textures.lacquer(rng), shininess=0.5)
    glass, tyre = replace(textures.even(0.12), shininess=0.6), textures.even(0.08)
    return [
        box("car", (0, 0, 0.62), (4.2, 1.7, 0.62), paint),
        box("cabin", (-0.2, 0, 1.16), (2.2, 1.5, 0.48), glass),
        box("roof", (-0.2, 0, 1.42), (1.9, 1.45, 0.06), paint),
        *(
            ball("wheel", (*at, 0.32), (0.32, 0.1, 0.32), tyre, rings=8)
            for at in product((-1.3, 1.3), (-0.8, 0.8))
        ),
    ]


def _tree(rng: Rng, x: float, y: float, bark: Material) -> list[Mesh]:
    h, leaf = rng.uniform(1.8, 3.0), textures.leaves(rng)
    out = [cylinder("trunk", (x, y, 0), (0.22, 0.14), h, bark, sides=10)]
    for _ in range(5):
        at = np.array([x, y, h + 0.8]) + rng.normal(0, 0.6, 3)
        out.append(ball("crown", at, rng.uniform(0.8, 1.4, 3), leaf, rings=8))
    return out


def _sky(rng: Rng) -> Mesh:
    """A glowing dome labelled as background: blue above, pale at the horizon."""
    height = np.linspace(1, 0, textures.SIZE)[:, None]
    clouds = np.clip(textures.noise(rng, 1, 40, 1.4) - rng.uniform(0.0, 1.0), 0, 1.0)
    blue, pale = np.array([0.36, 0.56, 0.86]), np.array([0.80, 0.88, 0.95])
    colour = pale + (blue - pale) * np.clip(height * 2 - 1, 0, 1)[..., None]
    colour = colour + (0.97 - colour) * 0.8 * clouds[..., None]
    air = Material(textures.to_bytes(colour), 2 * np.pi * 55, glows=True, part=BACKGROUND)
    return ball("sky", (0, 0, 0), (55, 55, 55), air, inward=True, rings=12)
