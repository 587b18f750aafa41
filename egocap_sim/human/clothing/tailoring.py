"""Garment meshes and their textures: fabric, details, folds and ambient shade on panels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numba
import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray as Array

from egocap_sim.human.body.anny_model import BareBody
from egocap_sim.human.body.body_chart import ARMS, TORSO
from egocap_sim.human.body.noise import stretched, wrapped_noise
from egocap_sim.human.body.skinning import Worn, skinned_mesh
from egocap_sim.human.body.triangles import distinct
from egocap_sim.human.clothing.details import DETAILS, Canvas, Marks
from egocap_sim.human.clothing.panels import GIRTH, REACH, SIZE, Panel, lay_out, unroll
from egocap_sim.human.clothing.shell import Shell

FOLD = 0.55  # strength of painted folds where cloth crumples
SHADE = 0.62  # largest share of light lost to ambient occlusion
SHADE_CELLS = 28  # cells along each side of a panel's shade grid


@dataclass(frozen=True, eq=False)
class Cloth:
    """Fabric, folds and painted details of a garment."""

    tile: UInt8[Array, "N N 3"]  # seamless image of the fabric
    tile_m: float  # metres that the tile covers
    rng: np.random.Generator
    crumple: float = 1.0  # depth of folds: 0 for tight cloth, 1 for cotton
    details: tuple[str, ...] = ()  # of `details.DETAILS`
    marks: Marks = field(default_factory=Marks)


def sew(name: str, shell: Shell, body: BareBody, cloth: Cloth, shininess: float = 0.0) -> Worn:
    """Make the mesh of a shell and paint its texture.

    Vertices are duplicated along the seams between pieces and along the cut of each piece.
    """
    corner_piece = np.repeat(shell.piece.take(shell.faces.T).max(0), 3)
    corner_vertex = shell.faces.ravel()
    turn, along = np.zeros(len(corner_vertex)), np.zeros(len(corner_vertex))
    spans = {}
    for piece in GIRTH:
        here = corner_piece == piece
        if here.any():
            turn[here], along[here] = unroll(piece, shell.vertices[corner_vertex[here]], body)
            spans[piece] = (float(along[here].max()) + 1e-4, float(along[here].min()) - 1e-4)
    turn = turn.reshape(-1, 3)
    turn = (turn + ((turn.max(1, keepdims=True) - turn) > 0.5)).ravel()  # across the seam
    key = (corner_vertex * len(GIRTH) + corner_piece) * 2 + (turn >= 1.0)
    first, index = distinct(key)
    vertex, pieces = corner_vertex[first], corner_piece[first]
    turn, along = turn[first], along[first]
    panels, light = lay_out(spans), shell.light[vertex]
    uv, samples = np.zeros((len(vertex), 2)), {}
    for piece, panel in panels.items():
        here = pieces == piece
        uv[here] = panel.uv(turn[here], along[here])
        samples[piece] = turn[here], along[here], light[here]
    mesh = skinned_mesh(
        name, shell.vertices[vertex], index.reshape(-1, 3), uv, paint(panels, samples, cloth),
        shell.weights[vertex], shininess,
    )  # fmt: skip
    return Worn(mesh, shell.covered)


def paint(
    panels: Mapping[int, Panel], light: Mapping[int, tuple[Array, Array, Array]], cloth: Cloth
) -> UInt8[Array, "512 512 3"]:
    """The texture of a garment; `light` is turn, along and openness of each panel's vertices."""
    image = np.zeros((SIZE, SIZE, 3), np.uint8)
    for piece, panel in panels.items():
        canvas = Canvas(panel, lay_tile(panel, cloth.tile, cloth.tile_m), cloth.marks, cloth.rng)
        for name in cloth.details:
            if (detail := DETAILS[name].get(piece)) is not None:
                detail(canvas)
        shade = canvas.relief + cloth.crumple * folds(panel, cloth.marks, cloth.rng)
        shade = (1 + np.clip(shade, -0.45, 0.3)) * shadow(panel, *light[piece])
        _shade(canvas.image, shade, image[panel.window])
    return image


@numba.njit(cache=True)
def _shade(
    image: Float[Array, "H W 3"], shade: Float[Array, "H W"], out: UInt8[Array, "H W 3"]
) -> None:
    """Multiply an image (0 to 255) by its shade."""
    height, width, channels = image.shape
    for y in range(height):
        for x in range(width):
            for c in range(channels):
                value = image[y, x, c] * shade[y, x] + np.float32(0.5)
                out[y, x, c] = min(max(value, np.float32(0)), np.float32(255))


def lay_tile(panel: Panel, tile: UInt8[Array, "N N 3"], tile_m: float) -> Float[Array, "H W 3"]:
    """Repeat a fabric over a panel, a whole number of times around, so that no seam shows."""
    repeats = max(1, round(GIRTH[panel.piece] / tile_m))
    n = len(tile)
    column = (panel.turns * repeats * n).astype(int) % n
    row = np.floor(-panel.along / tile_m * n).astype(int) % n
    return tile.take(row, 0).take(column, 1).astype(np.float32)


def folds(panel: Panel, marks: Marks, rng: np.random.Generator) -> Float[Array, "H W"]:
    """Shading of folds lit from above; folds are deep at joints, hems and the waist."""
    turns, along = panel.turns.astype(np.float32), panel.along.astype(np.float32)
    around = max(2, round(GIRTH[panel.piece] / 0.16))
    length = panel.top - panel.bottom
    wide, rows = round(panel.width / REACH), panel.height

    def ridges(strength: float, cells_m: float, slant: float, share: float) -> Array:
        cells = max(2, round(length / cells_m))
        noise = wrapped_noise(rows, wide, cells, max(2, round(around * share)), rng)
        shift = (slant * along / GIRTH[panel.piece] * wide).astype(int)
        return _slopes(noise, shift, panel.width, strength * rows / length * cells_m)

    steep = 0.8 if panel.piece == TORSO else 1.5
    drape = ridges(0.20, 0.10, steep, 0.8) + ridges(0.16, 0.07, -steep, 1.2)
    stacked = ridges(0.24, 0.035, 0.25, 1.3)
    deep = sum(
        strength * np.exp(-0.5 * ((along[:, None] - place) / width) ** 2)
        for place, width, strength in marks.creases(panel)
    )
    if panel.piece == TORSO:
        high = np.clip((along - marks.chest + 0.1) / 0.15, 0, 1)[:, None]
        sides = sum(np.exp(-0.5 * ((turns % 1 - side) / 0.07) ** 2) for side in (0.25, 0.75))
        deep = deep + 0.7 * high * sides
    elif panel.piece in ARMS:
        deep = deep * (0.6 + 0.8 * (np.abs(turns % 1 - 0.5) > 0.25))  # deeper on the inner side
    return FOLD * (drape * (0.35 + 0.5 * deep) + stacked * np.minimum(deep, 1.2))


@numba.njit(cache=True)
def _slopes(
    noise: Float[Array, "H w"], shift: Int[Array, "H"], width: int, steepness: float
) -> Float[Array, "H width"]:
    """Slope, down the rows, of ridges along the zeros of noise; each row is shifted."""
    height, around = noise.shape
    ridge = np.empty((height, width), np.float32)
    for y in range(height):
        column = shift[y] % around
        for x in range(width):
            ridge[y, x] = np.float32(1) - np.float32(2) * abs(noise[y, column])
            column = column + 1 if column + 1 < around else 0
    slope = np.zeros((height, width), np.float32)
    for y in range(height - 1):
        for x in range(width):
            slope[y, x] = (ridge[y + 1, x] - ridge[y, x]) * np.float32(steepness)
    return slope


def shadow(
    panel: Panel, turn: Float[Array, "N"], along: Float[Array, "N"], light: Float[Array, "N"]
) -> Float[Array, "H W"]:
    """Brightness (0 to 1) from ambient occlusion, interpolated from vertices over the panel."""
    n = SHADE_CELLS
    x = np.clip((np.asarray(panel.x(turn)) / panel.width * n).astype(int), 0, n - 1)
    y = np.clip((np.asarray(panel.y(along)) / panel.height * n).astype(int), 0, n - 1)
    cell = y * n + x
    grids = np.stack([np.bincount(cell, light, n * n), np.bincount(cell, minlength=n * n)])
    grids = grids.reshape(2, n, n)  # the sum of the vertices' light, and their number
    for reach in (1, 1, 2, 4, 8):  # empty cells take the mean of their neighbours
        wide = _blurred(grids, reach)
        grids = np.where(grids[1] == 0, wide, grids) if reach > 1 else wide
    value = (grids[0] / np.maximum(grids[1], 1e-9)).astype(np.float32)
    value = 1 - SHADE * (1 - np.clip(value, 0, 1)) ** 1.3
    return stretched(value, *_steps(panel.height), *_steps(panel.width))


def _blurred(grids: Float[Array, "2 H W"], reach: int) -> Float[Array, "2 H W"]:
    for axis in (1, 2):
        n = grids.shape[axis]
        at = np.clip(np.arange(n)[:, None] + np.array([-reach, 0, reach]), 0, n - 1)
        grids = grids.take(at, axis).sum(axis + 1) / 3
    return grids


def _steps(size: int) -> tuple[Int[Array, "size"], Float[Array, "size"]]:
    """The cell before each of `size` pixels, and the fraction of the way to the next cell."""
    cells = SHADE_CELLS
    at = np.clip((np.arange(size, dtype=np.float32) + 0.5) * cells / size - 0.5, 0, cells - 1.001)
    low = at.astype(int)
    return low, (at - low).astype(np.float32)
