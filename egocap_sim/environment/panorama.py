"""The distant background: a panorama on a dome, procedural or from a file.

Panoramas are equirectangular: columns are azimuth (the middle is +x, clockwise to the right as
seen from above), rows elevation from the zenith down.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.errors import FileError
from egocap_sim.assets import textures
from egocap_sim.assets.mesh import Mesh
from egocap_sim.assets.primitives import grid_faces
from egocap_sim.core.part_labels import BACKGROUND
from egocap_sim.environment.place import Place, direction
from egocap_sim.environment.texture_folder import decode_picture

WIDTH, HEIGHT = 2048, 1024  # pixels
RADIUS_M = 55.0
_PIECE = 512  # pixels: the dome is cut into pieces as fine as other textures
_STEPS = 6  # of a piece's mesh along each edge

Picture = UInt8[Array, "H W 3"]


def make_panorama(rng: np.random.Generator) -> Picture:
    """Sky with clouds, hills, houses and trees along the horizon, and ground below."""
    elevation = 90.0 - (np.arange(HEIGHT) + 0.5) * 180.0 / HEIGHT  # degrees, a row each
    image = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    above, below = elevation >= 0, elevation < 0
    image[above] = _sky(rng, elevation[above])
    haze = image[HEIGHT // 2 - 8].mean(0)
    for k in range(2):  # hills, the farther ones paler
        ridge = (2.0 + 2.5 * (1 - k)) * (1.0 + 0.5 * _ridge(rng, 5 + 6 * k))
        green = np.array([0.32, 0.40, 0.30]) * rng.uniform(0.7, 1.1)
        _below(image, elevation, ridge, haze + (0.35 + 0.3 * k) * (green - haze))
    if rng.random() < 0.6:
        _houses(image, elevation, rng)
    _trees(image, elevation, rng, 0.9 if rng.random() < 0.6 else 0.35)
    soil = (np.array([0.36, 0.38, 0.28]), np.array([0.42, 0.42, 0.41]))[int(rng.integers(2))]
    share = np.clip(-elevation[below] / 12.0, 0.0, 1.0)[:, None, None]
    ground = ((haze * 0.75) * (1 - share) + soil * share).astype(np.float32)
    rough = 1.0 + 0.06 * _tiled(rng, 10, 120)[below, :, None]
    image[below] = ground * rough
    return textures.to_bytes(image)


def read_panorama(path: Path) -> Picture:
    """A user's panorama (RGB), resized to 2048 x 1024. Raises FileError if it cannot be read."""
    image = decode_picture(path, "an equirectangular JPEG or PNG")
    if not 1.8 <= image.shape[1] / image.shape[0] <= 2.2:
        size = f"{image.shape[1]} x {image.shape[0]}"
        raise FileError(path, f"is {size} pixels", valid="a panorama twice as wide as high")
    return cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)


def dome(picture: Picture) -> list[Mesh]:
    """A dome with the panorama around the origin: it glows and is labelled as background."""
    corners = product(range(0, HEIGHT, _PIECE), range(0, WIDTH, _PIECE))
    return [_piece(picture, top, left) for top, left in corners]


def with_panorama(place: Place, picture: Picture) -> Place:
    """A place with the panorama instead of its sky."""
    kept = tuple(mesh for mesh in place.meshes if mesh.name != "sky")
    return replace(place, meshes=(*kept, *dome(picture)))


def _piece(picture: Picture, top: int, left: int) -> Mesh:
    """The part of the dome that shows a square of the picture."""
    step = np.linspace(0, _PIECE, _STEPS + 1)
    row, column = np.meshgrid(top + step, left + step, indexing="ij")
    points = direction(np.pi - column / WIDTH * 2 * np.pi, np.pi / 2 - row / HEIGHT * np.pi)
    # Half a pixel inside the edges: textures wrap, and interpolation would mix both sides.
    edge = 0.5 / _PIECE
    uv = np.stack([(column - left) / _PIECE, (row - top) / _PIECE], -1).clip(edge, 1 - edge)
    texture = np.ascontiguousarray(picture[top : top + _PIECE, left : left + _PIECE])
    vertices = RADIUS_M * np.moveaxis(points, 0, -1).reshape(-1, 3)
    return Mesh(
        "sky", vertices, grid_faces(_STEPS, _STEPS), uv.reshape(-1, 2), texture,
        np.full(len(vertices), BACKGROUND, np.uint8), casts_shadow=False, glows=True,
    )  # fmt: skip


def _sky(rng: np.random.Generator, elevation: Float[Array, "h"]) -> Float[Array, "h W 3"]:
    """Rows of sky at these elevations (degrees)."""
    blue, pale = np.array([0.34, 0.54, 0.85]), np.array([0.82, 0.88, 0.93])
    grey = rng.uniform(0.0, 0.7)  # overcast
    blue = blue + grey * (np.array([0.70, 0.73, 0.77]) - blue)
    share = np.clip(elevation / 50.0, 0.0, 1.0)[:, None, None] ** 0.6
    clouds = _tiled(rng, 2, 40)[: len(elevation)]
    clouds = np.clip(clouds - np.float32(rng.uniform(-0.2, 1.0)), 0.0, 1.0)[..., None]
    colour = (pale + share * (blue - pale)).astype(np.float32)
    return colour + 0.75 * clouds * (0.96 - colour)


def _tiled(rng: np.random.Generator, low: float, high: float) -> Float[Array, "H W"]:
    """Noise that is periodic in azimuth."""
    square = textures.noise(rng, low, high, 1.3).astype(np.float32)
    return cv2.resize(np.hstack([square] * 2), (WIDTH, HEIGHT), interpolation=cv2.INTER_LINEAR)


def _ridge(rng: np.random.Generator, waves: int) -> Float[Array, "W"]:
    """A line, periodic in azimuth, with a standard deviation of about 0.7."""
    k = np.arange(1, waves * 4)
    phase, size = rng.uniform(0, 2 * np.pi, len(k)), rng.normal(size=len(k)) / (1 + k / waves)
    line = (size * np.sin(2 * np.pi * np.outer(np.arange(WIDTH) / WIDTH, k) + phase)).sum(1)
    return 0.7 * line / max(line.std(), 1e-9)


def _below(image: Array, elevation: Array, top: Array, colour: Array) -> None:
    """Fill the area between the horizon and a line of elevations (degrees), antialiased."""
    rows = np.flatnonzero((elevation >= 0) & (elevation < top.max()))
    cover = np.clip((top - elevation[rows, None]) * HEIGHT / 180.0, 0.0, 1.0)[..., None]
    image[rows] += cover * (colour - image[rows])


def _houses(image: Array, elevation: Array, rng: np.random.Generator) -> None:
    """Draw blocks with rows of windows along parts of the horizon."""
    x = 0
    stretch = _ridge(rng, 3) > rng.uniform(-0.6, 0.6)
    while x < WIDTH - 8:
        wide, high = int(rng.integers(24, 90)), rng.uniform(3.0, 12.0)
        if stretch[min(x + wide // 2, WIDTH - 1)]:
            wall = np.array([0.72, 0.68, 0.62]) * rng.uniform(0.55, 1.15, 3) ** 0.5
            rows = np.flatnonzero((elevation < high) & (elevation > -0.5))
            block = np.broadcast_to(wall, (len(rows), min(wide, WIDTH - x), 3)).copy()
            block *= 1.0 - 0.15 * rng.random()
            step = int(rng.integers(6, 10))
            for r in range(3, len(rows) - 4, step):
                for c in range(3, block.shape[1] - 4, step - 1):
                    block[r : r + step // 2, c : c + step // 2] = rng.uniform(0.18, 0.45)
            image[rows, x : x + wide] = block
        x += wide + int(rng.integers(0, 30))


def _trees(image: Array, elevation: Array, rng: np.random.Generator, density: float) -> None:
    """Draw tree crowns along the horizon."""
    leaf = np.array([0.20, 0.30, 0.14])
    for _ in range(int(220 * density)):
        at, wide = rng.integers(WIDTH), rng.uniform(8, 30)
        high, colour = rng.uniform(1.0, 4.5), leaf * rng.uniform(0.6, 1.3)
        x = np.arange(-int(wide), int(wide) + 1)
        bumpy = 1.0 + 0.12 * np.sin(x * rng.uniform(0.5, 1.2) + rng.uniform(0, 6))
        top = high * np.sqrt(np.maximum(1 - (x / wide) ** 2, 0)) * bumpy
        columns = (at + x) % WIDTH
        rows = np.flatnonzero((elevation < 6.5) & (elevation > -0.6))
        patch = image[np.ix_(rows, columns)]
        cover = np.clip((top - elevation[rows, None]) * HEIGHT / 180.0, 0, 1)[..., None]
        mottled = colour * (1 + 0.15 * rng.standard_normal((len(rows), len(columns), 1)))
        image[np.ix_(rows, columns)] = patch + cover * (mottled - patch)
