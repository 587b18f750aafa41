"""Places under the sky: a yard, a street, a lawn, a court, an open square."""

from __future__ import annotations

import numpy as np

from egocap import geometry
from egocap_sim.assets import textures
from egocap_sim.assets.mesh import Mesh
from egocap_sim.assets.primitives import ball, box, cylinder, placed, sheet
from egocap_sim.assets.textures import Surface
from egocap_sim.core import part_labels
from egocap_sim.environment.panorama import dome, make_panorama
from egocap_sim.environment.surroundings import Light, Place, direction_of, floor

Rng = np.random.Generator


def outdoor(rng: Rng, clear_radius: float) -> Place:
    """A yard or park under the sky: house wall, fence, trees."""
    reach = clear_radius + 14.0
    make_ground = (textures.grass, textures.paving, textures.concrete)[int(rng.integers(3))]
    lawn, yard = textures.grass(rng), make_ground(rng)
    meshes = [floor(np.full(2, reach), lawn), _patch(clear_radius + 1.5, yard), _sky(rng)]
    brick, bark = textures.bricks(rng), textures.wood(rng)
    y = clear_radius + rng.uniform(1.5, 3.0)
    meshes.append(
        box("house", (0, y + 2, 2.5), (12, 4, 5), brick.texture, brick.tile, part=part_labels.ROOM)
    )
    pane = textures.window(rng).texture
    for x in (-3.5, -0.5, 3.0):
        corner = (x, y - 0.01, 2.2)
        meshes.append(sheet("window", corner, (1.2, 0, 0), (0, 0, -1.3), pane))
    fence = textures.planks(rng)
    at = (0, -clear_radius - rng.uniform(2, 5), 0.6)
    meshes.append(box("fence", at, (16, 0.05, 1.2), fence.texture, fence.tile))
    for _ in range(int(rng.integers(3, 7))):
        angle, r = rng.uniform(-0.9, 0.9) + np.pi * rng.integers(2), reach * rng.uniform(0.5, 0.8)
        meshes += _tree(rng, r * np.cos(angle), r * np.sin(angle), bark)
    return Place("outdoor", tuple(meshes), _daylight(rng), np.array([0.45, 0.6, 0.85]))


def street(rng: Rng, clear_radius: float) -> Place:
    """A pavement between a row of houses and a road with parked cars, lamps and trees."""
    reach = clear_radius + 14.0
    paving, road = textures.paving(rng), textures.asphalt(rng)
    meshes = [floor(np.full(2, reach), road), _sky(rng)]
    kerb = -clear_radius - rng.uniform(0.3, 1.0)
    front = clear_radius + rng.uniform(0.3, 1.2)
    meshes.append(
        sheet("pavement", (-reach, front, 0.004), (2 * reach, 0, 0), (0, kerb - front, 0),
              paving.texture, paving.tile)
    )  # fmt: skip
    x = -reach
    while x < reach:
        width, height = rng.uniform(5, 9), rng.uniform(5, 9)
        wall = (textures.bricks, textures.plaster)[int(rng.integers(2))](rng)
        middle = (x + width / 2, front + 3, height / 2)
        meshes.append(
            box("house", middle, (width, 6, height), wall.texture, wall.tile, part=part_labels.ROOM)
        )
        pane, wood = textures.window(rng).texture, textures.wood(rng)
        for k, at in enumerate(np.arange(x + 0.8, x + width - 1.4, 1.9)):
            if k == 1:
                door = (at + 0.5, front - 0.01, 1.05)
                meshes.append(
                    box("door", door, (1.0, 0.04, 2.1), wood.texture, part=part_labels.ROOM)
                )
            else:
                corner = (at, front - 0.01, 2.2)
                meshes.append(sheet("window", corner, (1.1, 0, 0), (0, 0, -1.3), pane))
            corner = (at, front - 0.01, 4.7)
            meshes.append(sheet("window", corner, (1.1, 0, 0), (0, 0, -1.3), pane))
        x += width
    for at in np.arange(-reach + 2, reach - 2, 5.5):
        if rng.random() < 0.6:
            meshes += placed(_car(rng), (at + rng.uniform(-0.4, 0.4), kerb - 1.2, 0.0))
    metal, bark = textures.even(np.full(3, 0.25)).texture, textures.wood(rng)
    for at in (-6.0, 6.5):
        meshes.append(cylinder("lamp post", (at, kerb - 0.15, 0), 0.06, 4.5, metal, sides=8))
    for at in (-reach * 0.6, reach * 0.55):
        meshes += _tree(rng, at, kerb - 4.0, bark)
    return Place("street", tuple(meshes), _daylight(rng), np.array([0.45, 0.6, 0.85]))


def square(rng: Rng, clear_radius: float) -> Place:
    """An open square: nothing near, a panorama of houses, trees and hills far away all around."""
    make_ground = (textures.paving, textures.concrete, textures.asphalt, textures.grass)
    ground = make_ground[int(rng.integers(4))](rng)
    meshes = [floor(np.full(2, clear_radius + 22.0), ground)]
    metal = textures.even(np.full(3, rng.uniform(0.2, 0.5))).texture
    for _ in range(int(rng.integers(0, 5))):
        angle, r = rng.uniform(0, 2 * np.pi), clear_radius + rng.uniform(1.0, 5.0)
        at = (r * np.cos(angle), r * np.sin(angle), 0.0)
        meshes.append(cylinder("bollard", at, 0.07, 0.9, metal, shininess=0.3, sides=10))
    meshes += dome(make_panorama(rng))
    return Place("square", tuple(meshes), _daylight(rng), np.array([0.45, 0.6, 0.85]))


def grass(rng: Rng, clear_radius: float) -> Place:
    """A meadow: grass, trees and bushes all around, a path."""
    reach = clear_radius + 16.0
    lawn, path, bark = textures.grass(rng), textures.concrete(rng), textures.wood(rng)
    meshes = [floor(np.full(2, reach), lawn), _sky(rng)]
    y = rng.uniform(-0.5, 0.5) * clear_radius
    meshes.append(
        sheet("path", (-reach, y + 0.7, 0.003), (2 * reach, 0, 0), (0, -1.4, 0),
              path.texture, path.tile)
    )  # fmt: skip
    leaf = textures.leaves(rng)
    for _ in range(int(rng.integers(7, 13))):
        angle, r = rng.uniform(0, 2 * np.pi), clear_radius + rng.uniform(4.5, 12)
        if rng.random() < 0.6:
            meshes += _tree(rng, r * np.cos(angle), r * np.sin(angle), bark)
        else:
            at = (r * np.cos(angle), r * np.sin(angle), 0.5)
            meshes.append(ball("bush", at, rng.uniform(0.6, 1.3, 3), leaf.texture, leaf.tile))
    return Place("grass", tuple(meshes), _daylight(rng), np.array([0.45, 0.6, 0.85]))


def court(rng: Rng, clear_radius: float) -> Place:
    """A sports court outdoors: coloured ground, lines, a basket, a fence."""
    half = np.array([max(7.0, clear_radius + 2.0), max(5.0, clear_radius + 1.5)])
    paint = textures.even(rng.uniform(0.2, 0.6, 3) * [1.0, 0.9, 0.8])
    rough = 1 + 0.05 * textures.noise(rng, 30, 250, 0.1)[..., None]
    texture = np.clip(paint.texture[0, 0] * rough, 0, 255).astype(np.uint8)
    lawn, white = textures.grass(rng), textures.even(np.full(3, 0.92)).texture
    meshes = [floor(half + 12.0, lawn), _sky(rng)]
    x, y = half
    meshes.append(sheet("court", (-x, y, 0.003), (2 * x, 0, 0), (0, -2 * y, 0), texture, 2.0))
    lines = [(0, y - 0.5, 2 * x - 1, 0.06), (0, 0.5 - y, 2 * x - 1, 0.06), (0, 0, 0.06, 2 * y - 1),
             (x - 0.5, 0, 0.06, 2 * y - 1), (0.5 - x, 0, 0.06, 2 * y - 1),
             (x - 3.2, 1.8, 5.4, 0.06), (x - 3.2, -1.8, 5.4, 0.06),
             (x - 5.9, 0, 0.06, 3.66)]  # fmt: skip
    for cx, cy, w, d in lines:
        corner = (cx - w / 2, cy + d / 2, 0.006)
        meshes.append(sheet("line", corner, (w, 0, 0), (0, -d, 0), white))
    steel = textures.even(np.full(3, 0.35)).texture
    orange = textures.even(np.array([0.85, 0.35, 0.12])).texture
    meshes.append(cylinder("post", (x + 0.6, 0, 0), 0.09, 3.6, steel, sides=10))
    meshes.append(box("board", (x + 0.2, 0, 3.4), (0.05, 1.8, 1.05), white))
    meshes.append(cylinder("basket", (x - 0.05, 0, 3.03), 0.23, 0.03, orange))
    for at in np.arange(-x - 1, x + 1.1, 2.5):
        for side in (-y - 1, y + 1):
            meshes.append(cylinder("fence post", (at, side, 0), 0.03, 2.2, steel, sides=6))
    for side in (-y - 1, y + 1):
        for z in (0.15, 1.1, 2.15):
            meshes.append(box("rail", (0, side, z), (2 * x + 2, 0.03, 0.03), steel))
    bark = textures.wood(rng)
    for _ in range(5):
        angle = rng.uniform(0, 2 * np.pi)
        r = float(np.hypot(x, y)) + rng.uniform(3.5, 7)
        meshes += _tree(rng, r * np.cos(angle), r * np.sin(angle), bark)
    return Place("court", tuple(meshes), _daylight(rng), np.array([0.45, 0.6, 0.85]))


def _daylight(rng: Rng) -> Light:
    """The sun somewhere above, and the sky."""
    elevation, azimuth = rng.uniform(0.6, 1.2), rng.uniform(0, 2 * np.pi)
    return Light(
        -direction_of(azimuth, elevation),
        color=np.array([1.0, 0.95, 0.85]) * rng.uniform(0.6, 0.9),
        sky=np.array([0.34, 0.39, 0.47]),
        ground=np.array([0.13, 0.13, 0.10]),
        sky_axis=geometry.UP,
    )


def _car(rng: Rng) -> tuple[Mesh, ...]:
    """A parked car along x."""
    paint = textures.lacquer(rng).texture
    glass, tyre = (textures.even(np.full(3, v)).texture for v in (0.12, 0.08))
    out = [
        box("car", (0, 0, 0.62), (4.2, 1.7, 0.62), paint, shininess=0.5),
        box("cabin", (-0.2, 0, 1.16), (2.2, 1.5, 0.48), glass, shininess=0.6),
        box("roof", (-0.2, 0, 1.42), (1.9, 1.45, 0.06), paint, shininess=0.5),
    ]
    for dx in (-1.3, 1.3):
        for dy in (-0.8, 0.8):
            out.append(ball("wheel", (dx, dy, 0.32), (0.32, 0.1, 0.32), tyre, rings=8))
    return tuple(out)


def _patch(half: float, surface: Surface) -> Mesh:
    return sheet(
        "yard", (-half, half, 0.003), (2 * half, 0, 0), (0, -2 * half, 0),
        surface.texture, surface.tile,
    )  # fmt: skip


def _tree(rng: Rng, x: float, y: float, bark: Surface) -> list[Mesh]:
    h, leaf = rng.uniform(1.8, 3.0), textures.leaves(rng)
    out = [cylinder("trunk", (x, y, 0), (0.22, 0.14), h, bark.texture, bark.tile, sides=10)]
    for _ in range(5):
        at = np.array([x, y, h + 0.8]) + rng.normal(0, 0.6, 3)
        out.append(ball("crown", at, rng.uniform(0.8, 1.4, 3), leaf.texture, leaf.tile, rings=8))
    return out


def _sky(rng: Rng) -> Mesh:
    """A dome that shines by itself and counts as background: blue above, pale at the horizon."""
    height = np.linspace(1, 0, textures.SIZE)[:, None]
    clouds = np.clip(textures.noise(rng, 1, 40, 1.4) - rng.uniform(0.0, 1.0), 0, 1.0)
    blue, pale = np.array([0.36, 0.56, 0.86]), np.array([0.80, 0.88, 0.95])
    colour = pale + (blue - pale) * np.clip(height * 2 - 1, 0, 1)[..., None]
    colour = colour + (0.97 - colour) * 0.8 * clouds[..., None]
    texture = np.round(np.clip(colour, 0, 1) * 255).astype(np.uint8)
    return ball(
        "sky", (0, 0, 0), (55, 55, 55), texture, 2 * np.pi * 55, part=part_labels.BACKGROUND,
        inward=True, rings=12, casts_shadow=False, glows=True,
    )  # fmt: skip
