"""Boxes, cylinders, balls and sheets as textured meshes, with texture at a natural size.

`tile` is always the size in metres that one repeat of the texture covers.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import cache

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray as Array

from egocap import geometry
from egocap_sim.assets.mesh import Mesh
from egocap_sim.core import part_labels

Texture = UInt8[Array, "H W 3"]


def sheet(
    name: str,
    corner: Iterable[float],
    across: Iterable[float],
    down: Iterable[float],
    texture: Texture,
    tile: float | None = None,
    *,
    part: int = part_labels.ROOM,
    casts_shadow: bool = False,
    glows: bool = False,
    cells: int = 1,
) -> Mesh:
    """A rectangle from its top-left corner, as seen by whoever it faces; metres.

    It faces down x across... that is, the viewer for whom `across` points right and `down` down.
    Without `tile` the texture is stretched over it once. It is cut into `cells` along each edge, so
    that light can differ over it.
    """
    c, a, d = (np.array(v, float) for v in (corner, across, down))
    repeats = (
        np.ones(2) if tile is None else np.array([np.linalg.norm(a), np.linalg.norm(d)]) / tile
    )
    step = np.linspace(0.0, 1.0, cells + 1)
    v, u = (k.reshape(-1, 1) for k in np.meshgrid(step, step, indexing="ij"))
    row, column = np.meshgrid(np.arange(cells), np.arange(cells), indexing="ij")
    k = (row * (cells + 1) + column).ravel()
    below = k + cells + 1
    faces = np.stack([np.c_[k, below, below + 1], np.c_[k, below + 1, k + 1]], 1).reshape(-1, 3)
    return Mesh(
        name, c + u * a + v * d, faces, np.hstack([u, v]) * repeats, texture,
        np.full(len(u), part, np.uint8), casts_shadow=casts_shadow, glows=glows,
    )  # fmt: skip


def box(
    name: str,
    center: Iterable[float],
    size: Iterable[float],
    texture: Texture,
    tile: float = 1.0,
    *,
    part: int = part_labels.FURNITURE,
    shininess: float = 0.0,
    casts_shadow: bool = True,
) -> Mesh:
    """A box with hard edges; the texture's rows follow z on its sides."""
    corners, faces, across, down = _unit_box()
    around = corners * (np.array(size, float) / 2)
    row = np.arange(len(corners))
    uv = np.stack([around[row, across], -around[row, down]], -1) / tile
    vertices = around + np.array(center, float)
    return _rigid(name, [vertices], [faces], [uv], texture, part, shininess, casts_shadow)


@cache
def _unit_box() -> tuple[Float[Array, "24 3"], Int[Array, "12 3"], Int[Array, "24"], Array]:
    """Corners (each coordinate -1 or 1) side by side, faces, and the axes along which the texture's
    columns and rows (24,) go."""
    corners, faces, across, down = [], [], [], []
    for axis, (u, v) in enumerate(((1, 2), (0, 2), (0, 1))):
        for sign in (-1.0, 1.0):
            corner = np.full((4, 3), sign)
            corner[:, u], corner[:, v] = (-1, 1, 1, -1), (-1, -1, 1, 1)
            outward = np.cross(corner[1] - corner[0], corner[3] - corner[0])[axis] * sign > 0
            turn = [[0, 1, 2], [0, 2, 3]] if outward else [[0, 2, 1], [0, 3, 2]]
            faces.append(np.array(turn) + 4 * len(corners))
            corners.append(corner)
            across += [u] * 4
            down += [v] * 4
    return np.concatenate(corners), np.concatenate(faces), np.array(across), np.array(down)


def cylinder(
    name: str,
    bottom: Iterable[float],
    radius: float | tuple[float, float],
    height: float,
    texture: Texture,
    tile: float = 1.0,
    *,
    part: int = part_labels.FURNITURE,
    shininess: float = 0.0,
    sides: int = 20,
    glows: bool = False,
) -> Mesh:
    """An upright cylinder, or cone with the radii below and above; closed at both ends."""
    below, above = radius if isinstance(radius, tuple) else (radius, radius)
    turn = np.linspace(0, 2 * np.pi, sides + 1)
    ring = np.c_[np.cos(turn), np.sin(turn), np.zeros_like(turn)]
    low, high = ring * below, ring * above + [0, 0, height]
    i = np.arange(sides)
    j = i + sides + 1
    side = np.concatenate([np.c_[i, i + 1, j + 1], np.c_[i, j + 1, j]])
    s = turn * max(below, above) / tile
    uv = np.concatenate([np.c_[s, np.full_like(s, height / tile)], np.c_[s, np.zeros_like(s)]])
    vertices, faces, uvs = [np.concatenate([low, high])], [side], [uv]
    for rim, order in ((high, [0, 1, 2]), (low, [0, 2, 1])):
        base = sum(map(len, vertices))
        middle = rim[:-1].mean(axis=0)
        vertices.append(np.concatenate([middle[None], rim]))
        faces.append((np.c_[np.zeros_like(i), i + 1, i + 2] + base)[:, order])
        uvs.append(vertices[-1][:, :2] / tile)
    vertices = [v + np.array(bottom, float) for v in vertices]
    mesh = _rigid(name, vertices, faces, uvs, texture, part, shininess, True)
    return replace(mesh, glows=glows, casts_shadow=not glows)


def ball(
    name: str,
    center: Iterable[float],
    radii: Iterable[float],
    texture: Texture,
    tile: float = 1.0,
    *,
    part: int = part_labels.FURNITURE,
    shininess: float = 0.0,
    inward: bool = False,
    rings: int = 10,
    casts_shadow: bool = True,
    glows: bool = False,
) -> Mesh:
    """An ellipsoid; `inward` shows its inside (a sky). One turn is a whole number of repeats."""
    unit, turn, faces = _unit_ball(rings)
    radii = np.array(list(radii), float)
    around = max(1, round(2 * np.pi * float(radii.max()) / tile))
    uv = turn * [around, max(1, around / 2)]
    faces = faces[:, ::-1] if inward else faces
    vertices = unit * radii + np.array(list(center), float)
    mesh = _rigid(name, [vertices], [faces], [uv], texture, part, shininess, casts_shadow)
    return replace(mesh, glows=glows)


@cache
def _unit_ball(rings: int) -> tuple[Float[Array, "N 3"], Float[Array, "N 2"], Int[Array, "F 3"]]:
    """Points of the unit sphere, their share of a turn around it and of the way down, faces."""
    lat, lon = np.meshgrid(
        np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, 2 * rings + 1), indexing="ij"
    )
    unit = np.stack([np.sin(lat) * np.cos(lon), np.sin(lat) * np.sin(lon), np.cos(lat)], -1)
    turn = np.stack([lon / (2 * np.pi), lat / np.pi], -1)
    n = 2 * rings + 1
    i, j = np.meshgrid(np.arange(rings), np.arange(n - 1), indexing="ij")
    k = (i * n + j).ravel()
    faces = np.concatenate([np.c_[k, k + n, k + n + 1], np.c_[k, k + n + 1, k + 1]])
    return unit.reshape(-1, 3), turn.reshape(-1, 2), faces


def tube(
    name: str,
    start: Iterable[float],
    end: Iterable[float],
    radius: float,
    texture: Texture,
    tile: float = 1.0,
    *,
    part: int = part_labels.FURNITURE,
    shininess: float = 0.0,
    sides: int = 8,
) -> Mesh:
    """A cylinder between two points."""
    a, b = np.array(list(start), float), np.array(list(end), float)
    length = float(np.linalg.norm(b - a))
    upright = cylinder(
        name, (0, 0, 0), radius, length, texture, tile, part=part, shininess=shininess, sides=sides
    )
    z = (b - a) / length
    x = geometry.unit(np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z))
    T = geometry.rigid(np.stack([x, np.cross(z, x), z], -1), a)
    return replace(upright, vertices=geometry.transform(T, upright.vertices))


def ring(
    name: str,
    radius: float,
    thickness: float,
    texture: Texture,
    *,
    part: int = part_labels.FURNITURE,
    sides: int = 28,
    around: int = 8,
) -> Mesh:
    """A torus about the y axis: a tyre, its middle line a circle of `radius`."""
    u, v = np.meshgrid(
        np.linspace(0, 2 * np.pi, sides + 1), np.linspace(0, 2 * np.pi, around + 1), indexing="ij"
    )
    r = radius + thickness * np.cos(v)
    vertices = np.stack([r * np.sin(u), thickness * np.sin(v), r * np.cos(u)], -1).reshape(-1, 3)
    n = around + 1
    i, j = np.meshgrid(np.arange(sides), np.arange(around), indexing="ij")
    k = (i * n + j).ravel()
    faces = np.concatenate([np.c_[k, k + n, k + n + 1], np.c_[k, k + n + 1, k + 1]])[:, ::-1]
    uv = np.stack([u * 4 / np.pi, v / (2 * np.pi)], -1).reshape(-1, 2)
    return _rigid(name, [vertices], [faces], [uv], texture, part, 0.0, True)


def placed(meshes: Iterable[Mesh], position: Iterable[float], yaw: float = 0.0) -> tuple[Mesh, ...]:
    """Meshes turned about z by `yaw` (rad) and moved to a position."""
    T = geometry.rigid(geometry.axis_angle(geometry.UP, yaw), np.array(list(position), float))
    return tuple(replace(m, vertices=geometry.transform(T, m.vertices)) for m in meshes)


def extent(meshes: Iterable[Mesh]) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Lower and upper corner of the box around meshes."""
    all_vertices = np.concatenate([m.vertices for m in meshes])
    return all_vertices.min(axis=0), all_vertices.max(axis=0)


def _rigid(name, vertices, faces, uv, texture, part, shininess, casts_shadow) -> Mesh:
    vertices = np.concatenate(vertices)
    return Mesh(
        name, vertices, np.concatenate(faces), np.concatenate(uv), texture,
        np.full(len(vertices), part, np.uint8), shininess=shininess, casts_shadow=casts_shadow,
    )  # fmt: skip
