"""Sheets, boxes, cylinders, balls, tubes and rings as textured meshes; lengths are metres."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import cache

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from egocap import geometry
from egocap_sim.assets.mesh import Material, Mesh
from egocap_sim.core.part_labels import FURNITURE, ROOM

Vector = Iterable[float]


def sheet(
    name: str,
    corner: Vector,
    across: Vector,
    down: Vector,
    material: Material,
    *,
    tiled: bool = False,
    cells: int = 1,
) -> Mesh:
    """A rectangle from its top-left corner, seen from the front.

    `across` points right and `down` down. Unless `tiled`, the texture covers it once. It is
    divided into `cells` along each edge, for lighting per vertex.
    """
    c, a, d = (np.array(v, float) for v in (corner, across, down))
    repeats = np.ones(2)
    if tiled:
        repeats = np.array([np.linalg.norm(a), np.linalg.norm(d)]) / material.tile
    step = np.linspace(0.0, 1.0, cells + 1)
    v, u = (k.reshape(-1, 1) for k in np.meshgrid(step, step, indexing="ij"))
    faces = np.stack(np.split(grid_faces(cells, cells), 2), 1).reshape(-1, 3)
    vertices, uv = c + u * a + v * d, np.hstack([u, v]) * repeats
    flat = replace(material, casts_shadow=bool(material.casts_shadow))
    return _textured(name, vertices, faces, uv, flat, ROOM)


def box(name: str, center: Vector, size: Vector, material: Material) -> Mesh:
    """A box with hard edges; the texture's rows follow z on its sides."""
    corners, faces, across, down = _unit_box()
    around = corners * (np.array(size, float) / 2)
    row = np.arange(len(corners))
    uv = np.stack([around[row, across], -around[row, down]], -1) / material.tile
    return _textured(name, around + np.array(center, float), faces, uv, material)


@cache
def _unit_box() -> tuple[Float[Array, "24 3"], Int[Array, "12 3"], Int[Array, "24"], Array]:
    """Corners (coordinates -1 or 1) of six sides, faces, and axes of texture columns and rows."""
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
    bottom: Vector,
    radius: float | tuple[float, float],
    height: float,
    material: Material,
    *,
    sides: int = 20,
) -> Mesh:
    """A closed upright cylinder, or a truncated cone with the lower and the upper radius."""
    below, above = radius if isinstance(radius, tuple) else (radius, radius)
    turn, tile = np.linspace(0, 2 * np.pi, sides + 1), material.tile
    circle = np.c_[np.cos(turn), np.sin(turn), np.zeros_like(turn)]
    low, high = circle * below, circle * above + [0, 0, height]
    i = np.arange(sides)
    j = i + sides + 1
    side = np.concatenate([np.c_[i, i + 1, j + 1], np.c_[i, j + 1, j]])
    s = turn * max(below, above) / tile
    uv = np.concatenate([np.c_[s, np.full_like(s, height / tile)], np.c_[s, np.zeros_like(s)]])
    vertices, faces, uvs = [np.concatenate([low, high])], [side], [uv]
    for rim, order in ((high, [0, 1, 2]), (low, [0, 2, 1])):
        base = sum(map(len, vertices))
        vertices.append(np.concatenate([rim[:-1].mean(axis=0)[None], rim]))
        faces.append((np.c_[np.zeros_like(i), i + 1, i + 2] + base)[:, order])
        uvs.append(vertices[-1][:, :2] / tile)
    points = np.concatenate(vertices) + np.array(bottom, float)
    return _textured(name, points, np.concatenate(faces), np.concatenate(uvs), material)


def ball(
    name: str,
    center: Vector,
    radii: Vector,
    material: Material,
    *,
    rings: int = 10,
    inward: bool = False,
) -> Mesh:
    """An ellipsoid with a seamless texture; `inward` shows its inside (a sky)."""
    unit, turn, faces = _unit_ball(rings)
    half = np.array(list(radii), float)
    around = max(1, round(2 * np.pi * float(half.max()) / material.tile))
    uv = turn * [around, max(1, around / 2)]
    vertices = unit * half + np.array(list(center), float)
    return _textured(name, vertices, faces[:, ::-1] if inward else faces, uv, material)


@cache
def _unit_ball(rings: int) -> tuple[Float[Array, "N 3"], Float[Array, "N 2"], Int[Array, "F 3"]]:
    """Points of the unit sphere, their azimuth and polar angle as shares (0 to 1), and faces."""
    lat, lon = np.meshgrid(
        np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, 2 * rings + 1), indexing="ij"
    )
    unit = np.stack([np.sin(lat) * np.cos(lon), np.sin(lat) * np.sin(lon), np.cos(lat)], -1)
    turn = np.stack([lon / (2 * np.pi), lat / np.pi], -1)
    return unit.reshape(-1, 3), turn.reshape(-1, 2), grid_faces(rings, 2 * rings)


def tube(
    name: str, start: Vector, end: Vector, radius: float, material: Material, *, sides: int = 8
) -> Mesh:
    """A cylinder between two points."""
    a, b = np.array(list(start), float), np.array(list(end), float)
    length = float(np.linalg.norm(b - a))
    upright = cylinder(name, (0, 0, 0), radius, length, material, sides=sides)
    z = (b - a) / length
    x = geometry.unit(np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z))
    T = geometry.rigid(np.stack([x, np.cross(z, x), z], -1), a)
    return replace(upright, vertices=geometry.transform(T, upright.vertices))


def ring(name: str, radius: float, thickness: float, material: Material) -> Mesh:
    """A torus about the y axis with the centre line `radius`, such as a tyre."""
    sides, around = 28, 8
    u, v = np.meshgrid(
        np.linspace(0, 2 * np.pi, sides + 1), np.linspace(0, 2 * np.pi, around + 1), indexing="ij"
    )
    r = radius + thickness * np.cos(v)
    vertices = np.stack([r * np.sin(u), thickness * np.sin(v), r * np.cos(u)], -1).reshape(-1, 3)
    uv = np.stack([u * 4 / np.pi, v / (2 * np.pi)], -1).reshape(-1, 2)
    return _textured(name, vertices, grid_faces(sides, around)[:, ::-1], uv, material)


def grid_faces(rows: int, columns: int) -> Int[Array, "F 3"]:
    """Triangles of a grid of (rows + 1) x (columns + 1) points in row order, two for each cell."""
    row, column = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    k = (row * (columns + 1) + column).ravel()
    below = k + columns + 1
    return np.concatenate([np.c_[k, below, below + 1], np.c_[k, below + 1, k + 1]])


def placed(meshes: Iterable[Mesh], position: Vector, yaw: float = 0.0) -> tuple[Mesh, ...]:
    """Meshes rotated about z by `yaw` (rad) and moved to a position."""
    T = geometry.rigid(geometry.axis_angle(geometry.UP, yaw), np.array(list(position), float))
    return tuple(replace(m, vertices=geometry.transform(T, m.vertices)) for m in meshes)


def extent(meshes: Iterable[Mesh]) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Lower and upper corner of the bounding box of meshes."""
    all_vertices = np.concatenate([m.vertices for m in meshes])
    return all_vertices.min(axis=0), all_vertices.max(axis=0)


def _textured(
    name: str, vertices: Array, faces: Array, uv: Array, material: Material, part: int = FURNITURE
) -> Mesh:
    """A rigid mesh; `part` is its label unless the material has one."""
    shadow = not material.glows if material.casts_shadow is None else material.casts_shadow
    label = part if material.part is None else material.part
    return Mesh(
        name, vertices, faces, uv, material.texture, np.full(len(vertices), label, np.uint8),
        shininess=material.shininess, casts_shadow=shadow, glows=material.glows,
    )  # fmt: skip
