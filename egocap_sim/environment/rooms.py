"""Indoor places: a furnished room, a studio, a green room, a corridor."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap import geometry
from egocap_sim.assets import furniture, textures
from egocap_sim.assets.mesh import Material, Mesh
from egocap_sim.assets.primitives import box, extent, placed, sheet
from egocap_sim.core.part_labels import ROOM
from egocap_sim.environment.place import Light, Place, direction, flat, floor

Rng = np.random.Generator
Half = Float[Array, "2"]  # half a room's length (x) and width (y), metres
_CELLS = 10  # along a wall, for light that decreases towards corners


def room(rng: Rng, clear_radius: float) -> Place:
    """A furnished room with a window, pictures, and sometimes a ceiling and a rug."""
    half = clear_radius + rng.uniform(0.9, 1.6, 2)
    height = float(rng.uniform(2.5, 3.0))
    ground, wall, accent = (_any_of(c, rng) for c in (textures.FLOORS, *[textures.WALLS] * 2))
    sunny = int(rng.integers(4))  # the wall with the window
    meshes = [floor(half, ground, _CELLS), *_walls(half, height, [wall, wall, accent, wall])]
    if rng.random() < 0.6:
        meshes += _ceiling(half, height)
    meshes += _on_wall(sunny, half, _window(rng, height))
    if rng.random() < 0.6:
        meshes += _rug(rng, clear_radius)
    meshes += _furnish(rng, half, clear_radius, sunny)
    light = _indoor_light(rng, sunny)
    grey = np.array([0.5, 0.5, 0.52])
    return Place("room", tuple(meshes), light, grey, np.array([*half, height]))


def studio(rng: Rng, clear_radius: float) -> Place:
    """A motion-capture studio: plain floor and walls, and lamps."""
    half = np.full(2, clear_radius + rng.uniform(1.0, 2.0))
    paint = textures.even(rng.uniform(0.3, 0.75))
    ground = textures.concrete(rng) if rng.random() < 0.5 else textures.carpet(rng)
    meshes = [floor(half, ground, _CELLS), *_walls(half, 3.5, [paint] * 4)]
    for k in range(4):
        at = np.array([1, 1 if k % 2 else -1]) * (half - 0.4) * (1 if k < 2 else -1)
        meshes += placed(furniture.floor_lamp(rng), (*at, 0.0))
    dark = np.full(3, 0.3)
    return Place("studio", tuple(meshes), _indoor_light(rng, 0), dark, np.array([*half, 3.5]))


def chroma(rng: Rng, _clear_radius: float) -> Place:
    """A uniform green background for chroma keying.

    It has no meshes, which saves a third of the time per frame, and receives no shadows.
    """
    light = Light(
        geometry.unit(np.array([0.2, rng.uniform(-0.3, 0.3), -1.0])),
        color=np.full(3, 0.25), sky=np.full(3, 0.7), ground=np.full(3, 0.55), sky_axis=geometry.UP,
    )  # fmt: skip
    return Place("chroma", (), light, np.array([0.01, 0.53, 0.04]))


def corridor(rng: Rng, clear_radius: float) -> Place:
    """A long narrow corridor with doors, pictures and ceiling lamps."""
    half = np.array([4.0 * clear_radius + 4.0, clear_radius + rng.uniform(0.05, 0.3)])
    height = float(rng.uniform(2.5, 2.9))
    ground, wall, end = _any_of(textures.FLOORS, rng), textures.plaster(rng), textures.plaster(rng)
    meshes = [floor(half, ground, _CELLS), *_walls(half, height, [end, wall, end, wall])]
    x, y = half
    white, glow = textures.even(0.9), replace(textures.even(1.0), glows=True)
    ceiling = (-x, -y, height), (2 * x, 0, 0), (0, 2 * y, 0)
    meshes.append(sheet("ceiling", *ceiling, white, cells=_CELLS))
    for at in np.arange(-x + 1.5, x - 1.0, 3.0):
        meshes.append(sheet("lamp", (at, -0.15, height - 0.02), (1.2, 0, 0), (0, 0.3, 0), glow))
    wood, paint = (replace(m, part=ROOM) for m in (textures.wood(rng), textures.even(0.35)))
    door = [
        box("door frame", (0, 0.01, 1.04), (1.0, 0.02, 2.08), paint),
        box("door", (0, 0.018, 1.0), (0.88, 0.03, 2.0), wood),
    ]
    for side in (1, 3):
        for at in np.arange(-x + 1.2, x - 1.2, rng.uniform(2.6, 4.0)) + rng.uniform(0, 0.5):
            meshes += _on_wall(side, half, door, float(at))
            if rng.random() < 0.5:
                meshes += _on_wall(side, half, _picture(rng), float(at) + 1.2)
    toward = direction(rng.uniform(0, 2 * np.pi), 1.35)
    light = Light(
        direction=-toward,
        color=np.full(3, rng.uniform(0.4, 0.6)),
        sky=np.array([1.0, 1.0, 0.98]) * rng.uniform(0.35, 0.5),
        ground=np.full(3, rng.uniform(0.12, 0.2)),
        sky_axis=geometry.UP,
        spread=0.2,  # a long lamp
    )
    return Place("corridor", tuple(meshes), light, np.full(3, 0.4), np.array([*half, height]))


def _any_of(makers: Sequence, rng: Rng) -> Material:
    return makers[int(rng.integers(len(makers)))](rng)


def _indoor_light(rng: Rng, sunny: int) -> Light:
    """Directional light from the side of the window, and ambient light."""
    azimuth = _YAW[sunny] - np.pi / 2  # of the wall's outside
    toward = direction(azimuth + rng.uniform(-0.5, 0.5), rng.uniform(0.8, 1.2))
    warm = np.array([1.0, rng.uniform(0.9, 1.0), rng.uniform(0.78, 1.0)])
    strength = rng.uniform(0.45, 0.75)
    return Light(
        direction=-toward,
        color=warm * strength,
        sky=np.array([0.98, 1.0, 1.02]) * rng.uniform(0.34, 0.5),
        ground=np.array([1.0, 0.96, 0.9]) * rng.uniform(0.12, 0.2),
        sky_axis=geometry.unit(geometry.UP + 0.6 * toward),
        spread=0.12,  # a window, or a large lamp
    )


# Walls 0 to 3 stand at +x, +y, -x, -y. The yaw turns meshes with their back at y = 0 so that
# their back faces the wall.
_YAW = (np.pi / 2, np.pi, -np.pi / 2, 0.0)


def _wall_frame(index: int, half: Half) -> tuple[Float[Array, "3"], float, float]:
    """A wall's middle at the floor, its yaw, and half its length."""
    middle = np.array([(half[0], 0, 0), (0, half[1], 0), (-half[0], 0, 0), (0, -half[1], 0)][index])
    return middle.astype(float), _YAW[index], float(half[1 if index % 2 == 0 else 0])


def _on_wall(index: int, half: Half, meshes: Iterable[Mesh], along: float = 0.0) -> list[Mesh]:
    middle, yaw, _ = _wall_frame(index, half)
    along_wall = geometry.axis_angle(geometry.UP, yaw) @ np.array([along, 0.0, 0.0])
    return list(placed(meshes, middle + along_wall, yaw))


def _walls(half: Half, height: float, materials: Sequence[Material]) -> list[Mesh]:
    out = []
    board = replace(textures.even(0.85), part=ROOM, casts_shadow=False)
    for k, material in enumerate(materials):
        length = _wall_frame(k, half)[2]
        rectangle = (length, 0, height), (-2 * length, 0, 0), (0, 0, -height)
        wall = sheet("wall", *rectangle, material, tiled=True, cells=_CELLS)
        skirting = box("skirting", (0, 0.008, 0.04), (2 * length, 0.016, 0.08), board)
        out += _on_wall(k, half, (wall, skirting))
    return out


def _ceiling(half: Half, height: float) -> list[Mesh]:
    x, y = half
    white, bright = textures.even(0.93), replace(textures.even((1.0, 0.98, 0.94)), glows=True)
    rectangle = (-x, -y, height), (2 * x, 0, 0), (0, 2 * y, 0)
    return [
        sheet("ceiling", *rectangle, white, cells=_CELLS),
        sheet("lamp", (-0.6, -0.3, height - 0.02), (1.2, 0, 0), (0, 0.6, 0), bright),
    ]


def _window(rng: Rng, height: float) -> list[Mesh]:
    w, h = rng.uniform(1.2, 2.0), rng.uniform(1.1, 1.5)
    top = min(height - 0.2, 2.3)
    pane, white = replace(textures.window(rng), glows=True), replace(textures.even(0.88), part=ROOM)
    return [
        sheet("window", (w / 2, 0.012, top), (-w, 0, 0), (0, 0, -h), pane),
        box("sill", (0, 0.06, top - h - 0.02), (w + 0.1, 0.12, 0.03), white),
    ]


def _rug(rng: Rng, clear_radius: float) -> list[Mesh]:
    reach = min(clear_radius, 2.0)
    w, d = rng.uniform(0.7, 1.3) * reach, rng.uniform(0.6, 1.0) * reach
    x, y = rng.uniform(-0.4, 0.4, 2)
    woven = flat("rug", (-w, d, 0.004), (2 * w, 2 * d), textures.rug(rng), tiled=False)
    return list(placed([woven], (x, y, 0), rng.uniform(-0.3, 0.3)))


def _furnish(rng: Rng, half: Half, clear_radius: float, sunny: int) -> list[Mesh]:
    """Furniture along the walls and pictures, outside the free circle."""
    out: list[Mesh] = []
    for k in range(4):
        middle, _, length = _wall_frame(k, half)
        depth = float(np.abs(middle).max()) - clear_radius
        at = -length + 0.75
        while at < length - 0.75:
            make = furniture.WALL_PIECES[int(rng.integers(len(furniture.WALL_PIECES)))]
            piece = make(rng)
            low, high = extent(piece)
            width = float(high[0] - low[0])
            fits = at + width <= length - 0.75 and high[1] + 0.03 <= depth
            blocks = k == sunny and high[2] > 1.0 and abs(at + width / 2) < 1.0 + width / 2
            if fits and not blocks:
                out += _on_wall(k, half, placed(piece, (-low[0], 0.03, 0.0)), at)
                at += width
            at += rng.uniform(0.1, 0.9)
        if k != sunny:
            out += _on_wall(k, half, _picture(rng), rng.uniform(-0.5, 0.5) * length)
    return out


def _picture(rng: Rng) -> list[Mesh]:
    w, h, z = rng.uniform(0.4, 1.0), rng.uniform(0.4, 0.8), rng.uniform(1.5, 1.7)
    wood, art = replace(textures.wood(rng), part=ROOM), textures.picture(rng)
    return [
        box("frame", (0, 0.012, z), (w + 0.08, 0.024, h + 0.08), wood),
        sheet("picture", (w / 2, 0.026, z + h / 2), (-w, 0, 0), (0, 0, -h), art),
    ]
