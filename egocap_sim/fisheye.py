"""Any camera out of flat pictures: which faces of a cube its lens sees, and how they become pixels.

The camera stands in the middle of a cube whose faces are rendered as flat pictures; every pixel of
the fisheye image is then looked up where its ray leaves the cube. A cube with an *edge* on the
optical axis covers a 180-degree lens with four faces. Each face is cropped to the rectangle the
lens sees (a `Tile`), and the tiles of all cameras are packed into one picture, the atlas.

Faces use the OpenCV convention (x right, y down, z out of the face); a face point has slopes
u = x/z and v = y/z within -1..1. The atlas is stored as OpenGL reads it back, bottom row first, so
rows grow against v. Atlas coordinates put the centre of the first pixel at 0, as `cv2.remap` and
our cameras do; OpenGL's own put it at 0.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import ceil, floor, pi
from typing import Protocol

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from egocap.camera import Camera
from egocap_sim.pixel_rays import pixel_rays

TILE_COST = 0.15  # drawing one more tile, in the area of a quarter face
MARGIN = 2  # pixels drawn past a tile's edge, so that interpolation never crosses a seam


class Lens(Protocol):
    """What is asked of a camera; `egocap.camera` has the real ones."""

    @property
    def width(self) -> int: ...

    @property
    def height(self) -> int: ...

    @property
    def max_angle(self) -> float: ...

    def ray(self, pixels: Float[Array, "*n 2"]) -> tuple[Array, Array]: ...


@dataclass(frozen=True, eq=False)
class Tile:
    """The part of one cube face that a lens sees, and its place in the atlas."""

    view: int
    face: int  # index among the faces of this view's cube
    R_camera_face: Float[Array, "3 3"]
    slopes: tuple[float, float, float, float]  # u0, u1, v0, v1 at the tile's outer borders
    column: int  # first pixel in the atlas
    row: int
    width: int
    height: int
    density: float  # pixels per unit of slope

    def atlas_of(self, directions_face: Float[Array, "*n 3"]) -> Float[Array, "*n 2"]:
        """Atlas coordinates of directions in the face's frame (z > 0)."""
        return self.at_slopes(directions_face[..., :2] / directions_face[..., 2:])

    def at_slopes(self, slopes: Float[Array, "*n 2"]) -> Float[Array, "*n 2"]:
        """Atlas coordinates of points of the face."""
        u0, _, _, v1 = self.slopes
        x = self.column + (slopes[..., 0] - u0) * self.density - 0.5
        y = self.row + (v1 - slopes[..., 1]) * self.density - 0.5
        return np.stack([x, y], -1)

    def ray_length(self) -> Float[Array, "h w"]:
        """Distance along the ray per unit of depth, at each pixel's centre (bottom row first)."""
        u0, _, _, v1 = self.slopes
        u = u0 + (np.arange(self.width) + 0.5) / self.density
        v = v1 - (np.arange(self.height) + 0.5) / self.density
        return np.sqrt(1.0 + u[None, :] ** 2 + v[:, None] ** 2)


@dataclass(frozen=True, eq=False)
class Atlas:
    """All tiles of all cameras, and for each camera the atlas coordinates of its pixels."""

    width: int
    height: int
    tiles: tuple[Tile, ...]
    lookup: tuple[Float[Array, "H W 2"], ...]  # float32 per view
    inside: tuple[Bool[Array, "H W"], ...]  # the lens forms an image here
    needed: Bool[Array, "h w"]  # atlas pixels that some ray comes near; the rest need no drawing
    _faces: tuple[tuple[Array, ...], ...] = field(repr=False, default=())

    def locate(
        self, view: int, directions: Float[Array, "N 3"]
    ) -> tuple[Int[Array, "N"], Float[Array, "N 2"]]:
        """Tile index and atlas coordinates of directions in a camera's frame.

        The tile is -1 where no tile of this view covers the direction; its coordinates then mean
        nothing.
        """
        directions = np.asarray(directions, float)
        tile_of = np.full(len(directions), -1)
        xy = np.zeros((len(directions), 2))
        face = _face_of(directions, self._faces[view])
        for i, tile in enumerate(self.tiles):
            if tile.view != view:
                continue
            chosen = face == tile.face
            at = tile.atlas_of(directions[chosen] @ tile.R_camera_face)
            low = np.array([tile.column, tile.row])
            high = low + [tile.width - 1, tile.height - 1]
            ok = np.all((at >= low) & (at <= high), -1)
            index = np.flatnonzero(chosen)[ok]
            tile_of[index], xy[index] = i, at[ok]
        return tile_of, xy


def build_atlas(
    cameras: Sequence[Lens], face_size: int | None = None, sharpness: float = 1.0
) -> Atlas:
    """Choose and pack the cube faces of each camera, and trace every pixel to them.

    `face_size` is the number of pixels along a whole cube face. Twice the camera's pixels per
    radian on the axis would give a face's middle, its coarsest place, the density of the image's
    centre; None takes 1.8 pixels per radian instead of 2, where markers without anti-aliasing still
    land within 0.25 pixels. `sharpness` scales it.
    """
    orientations: list[tuple[Array, ...]] = []
    traced: list[tuple[Array, Array]] = []  # per view: inside (H, W); slopes (H W, 2)
    pixels: list[tuple[int, int, Array]] = []  # per tile: view, face, pixels that look through it
    cropped: list[tuple[tuple[int, int, int, int], float]] = []  # per tile: box in pixels, density
    for view, camera in enumerate(cameras):
        rays, inside = _rays(camera)
        density = sharpness * (face_size or round(1.8 * _pixels_per_radian(camera))) / 2
        faces = min(_orientations(), key=lambda f: _cost(f, rays[::4, ::4], inside[::4, ::4]))
        face = np.where(inside, _face_of(rays, faces), -1).ravel()
        slopes = np.zeros((face.size, 2))
        for i, R in enumerate(faces):
            mine = np.flatnonzero(face == i)
            if len(mine):
                out = rays.reshape(-1, 3)[mine] @ R
                slopes[mine] = out[:, :2] / out[:, 2:]
                pixels.append((view, i, mine))
                cropped.append((_box(slopes[mine] * density), density))
        orientations.append(faces)
        traced.append((inside, slopes))
    width, height, corners = _pack([(x1 - x0, y1 - y0) for (x0, x1, y0, y1), _ in cropped])
    tiles, lookup = [], [np.full((i.size, 2), -9.0, np.float32) for i, _ in traced]  # off the atlas
    for (view, i, mine), ((x0, x1, y0, y1), density), corner in zip(
        pixels, cropped, corners, strict=True
    ):
        tile = Tile(
            view, i, orientations[view][i],
            (x0 / density, x1 / density, y0 / density, y1 / density), *corner,
            x1 - x0, y1 - y0, density,
        )  # fmt: skip
        lookup[view][mine] = tile.at_slopes(traced[view][1][mine])
        tiles.append(tile)
    insides = tuple(i for i, _ in traced)
    shaped = tuple(xy.reshape(*i.shape, 2) for xy, i in zip(lookup, insides, strict=True))
    needed = _needed(width, height, shaped, insides)
    return Atlas(width, height, tuple(tiles), shaped, insides, needed, tuple(orientations))


def _rays(camera: Lens) -> tuple[Array, Array]:
    if isinstance(camera, Camera):
        rays, angle = pixel_rays(camera)
        return rays, angle <= camera.max_angle
    x, y = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays, valid = camera.ray(np.stack([x, y], -1).astype(float))
    angle = np.arctan2(np.hypot(rays[..., 0], rays[..., 1]), rays[..., 2])
    return rays, valid & (angle <= camera.max_angle)


def _pixels_per_radian(camera: Lens) -> float:
    """Image density near the optical axis, from the angle between rays of neighbouring pixels."""
    step = min(8.0, camera.width / 4)
    x, y = (camera.width - 1) / 2, (camera.height - 1) / 2
    a, b = camera.ray(np.array([[x - step, y], [x + step, y]]))[0]
    return 2 * step / float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def _orientations() -> list[tuple[Array, ...]]:
    """Cubes to choose from: an edge on the axis (upright or lying), or a face on the axis."""
    cube = [_turn(1, a) for a in (0, pi / 2, pi, -pi / 2)] + [
        _turn(0, a) for a in (pi / 2, -pi / 2)
    ]
    return [
        tuple(_turn(axis, angle) @ R for R in cube)
        for axis, angle in ((1, pi / 4), (0, pi / 4), (0, 0))
    ]


def _turn(axis: int, angle: float) -> Array:
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[i, i] = R[j, j] = np.cos(angle)
    R[j, i], R[i, j] = np.sin(angle), -np.sin(angle)
    return R


def _face_of(directions: Float[Array, "*n 3"], faces: Sequence[Array]) -> Int[Array, "*n"]:
    """Index of the cube face each direction leaves through."""
    outward = np.stack([R[:, 2] for R in faces], -1)  # (3, 6)
    return np.argmax(directions @ outward, -1)


def _box(at: Float[Array, "N 2"]) -> tuple[int, int, int, int]:
    """Whole pixels (u0, u1, v0, v1, counted from the face's middle) that hold points of a face."""
    (u0, v0), (u1, v1) = at.min(axis=0), at.max(axis=0)
    return floor(u0) - MARGIN, ceil(u1) + MARGIN, floor(v0) - MARGIN, ceil(v1) + MARGIN


def _cost(faces: Sequence[Array], rays: Array, inside: Array) -> float:
    """Area to draw for one choice of cube, in squares of the face's half width, plus its tiles."""
    du, dv = np.gradient(rays, axis=1), np.gradient(rays, axis=0)
    solid_angle = np.linalg.norm(np.cross(du, dv), axis=-1)
    outward = np.max(rays @ np.stack([R[:, 2] for R in faces], -1), -1)  # cosine to the face's axis
    drawn = np.sum((solid_angle / outward**3)[inside])
    return float(drawn) + TILE_COST * len(np.unique(_face_of(rays, faces)[inside]))


def _needed(width: int, height: int, lookup: Sequence[Array], inside: Sequence[Array]) -> Array:
    needed = np.zeros((height, width), np.uint8)
    for xy, valid in zip(lookup, inside, strict=True):
        column, row = np.round(xy[valid]).astype(int).T
        needed[row, column] = 1
    # Neighbouring image pixels are up to four atlas pixels apart.
    return cv2.dilate(needed, np.ones((7, 7), np.uint8)) > 0


def _pack(sizes: Sequence[tuple[int, int]]) -> tuple[int, int, list[tuple[int, int]]]:
    """Place rectangles on shelves: total width, total height and each one's first pixel."""
    order = sorted(range(len(sizes)), key=lambda i: (-sizes[i][1], -sizes[i][0], i))
    widest, total = max(w for w, _ in sizes), sum(w for w, _ in sizes)
    best = None
    for limit in np.linspace(widest, total, 24).astype(int):
        corners, x, y, shelf, right = [(0, 0)] * len(sizes), 0, 0, 0, 0
        for i in order:
            w, h = sizes[i]
            if x and x + w > limit:
                x, y, shelf = 0, y + shelf, 0
            corners[i] = (x, y)
            x, shelf = x + w, max(shelf, h)
            right = max(right, x)
        key = (right * (y + shelf), max(right, y + shelf))
        if best is None or key < best[0]:
            best = (key, right, y + shelf, corners)
    assert best is not None
    return best[1], best[2], best[3]
