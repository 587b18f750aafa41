"""Fisheye images from perspective pictures: layout of the cube faces and the pixel lookup.

The camera is at the centre of a cube whose faces are rendered as perspective pictures; every pixel
of the fisheye image is then looked up where its ray leaves the cube. A cube with an *edge* on the
optical axis covers a 180-degree lens with four faces. Each face is cropped to the rectangle visible
to the lens (a `Tile`), and the tiles of all cameras are packed into one picture, the atlas.

The atlas is stored in OpenGL's order, bottom row first, so rows increase against v (`cube`).
Atlas coordinates put the centre of the first pixel at 0, as `cv2.remap` and our cameras do;
OpenGL's own put it at 0.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import ceil, floor

import cv2
import numba
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array

from egocap_sim.render.cube import Lens, cube_face, trace_pixels

MARGIN = 2  # pixels drawn past a tile's edge, so that interpolation never crosses a seam


@dataclass(frozen=True, eq=False)
class Tile:
    """The part of one cube face that is visible to a lens, and its place in the atlas."""

    view: int
    face: int  # index among the faces of this view's cube
    R_camera_face: Float[Array, "3 3"]
    slopes: tuple[float, float, float, float]  # u0, u1, v0, v1 at the tile's outer borders
    column: int  # first pixel in the atlas
    row: int
    width: int
    height: int
    density: float  # pixels per unit of slope

    def project(self, directions_face: Float[Array, "*n 3"]) -> Float[Array, "*n 2"]:
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
    needed: Bool[Array, "h w"]  # atlas pixels near some ray; others are not drawn
    _faces: tuple[Float[Array, "6 3 3"], ...] = field(repr=False, default=())

    def locate(
        self, view: int, directions: Float[Array, "N 3"]
    ) -> tuple[Int[Array, "N"], Float[Array, "N 2"]]:
        """Tile index and atlas coordinates of directions in a camera's frame.

        The tile is -1 where no tile of this view covers the direction; its coordinates are then
        undefined.
        """
        directions = np.asarray(directions, float)
        tile_of = np.full(len(directions), -1)
        xy = np.zeros((len(directions), 2))
        face = cube_face(directions, self._faces[view])
        for i, tile in enumerate(self.tiles):
            if tile.view != view:
                continue
            chosen = face == tile.face
            at = tile.project(directions[chosen] @ tile.R_camera_face)
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
    radian would match the image's density at a face's centre, its coarsest point; None takes 1.8
    times, where markers without anti-aliasing are still accurate to 0.25 pixels. `sharpness` scales
    it.
    """
    traces = [trace_pixels(camera) for camera in cameras]
    densities = [sharpness * (face_size or round(1.8 * _pixels_per_radian(c))) / 2 for c in cameras]
    seen = [(view, i) for view, trace in enumerate(traces) for i in trace.seen]
    boxes = [_box(traces[view].bounds[i] * densities[view]) for view, i in seen]
    width, height, corners = _pack([(x1 - x0, y1 - y0) for x0, x1, y0, y1 in boxes])
    tiles = tuple(
        _tile(view, i, traces[view].faces[i], box, corner, densities[view])
        for (view, i), box, corner in zip(seen, boxes, corners, strict=True)
    )
    drawn = np.zeros((height, width), np.uint8)
    lookup = tuple(
        _make_lookup(trace.face, trace.slopes, _origins(tiles, view), density, drawn)
        for view, (trace, density) in enumerate(zip(traces, densities, strict=True))
    )
    # Neighbouring image pixels are up to four atlas pixels apart.
    needed = cv2.dilate(drawn, np.ones((7, 7), np.uint8)) > 0
    inside = tuple(trace.face >= 0 for trace in traces)
    faces = tuple(trace.faces for trace in traces)
    return Atlas(width, height, tiles, lookup, inside, needed, faces)


def _pixels_per_radian(camera: Lens) -> float:
    """Image density near the optical axis, from the angle between rays of neighbouring pixels."""
    step = min(8.0, camera.width / 4)
    x, y = (camera.width - 1) / 2, (camera.height - 1) / 2
    a, b = camera.ray(np.array([[x - step, y], [x + step, y]]))[0]
    return 2 * step / float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def _box(bounds: Float[Array, "4"]) -> tuple[int, int, int, int]:
    """Whole pixels (u0, u1, v0, v1, counted from the face's middle) that hold part of a face."""
    u0, u1, v0, v1 = bounds
    return floor(u0) - MARGIN, ceil(u1) + MARGIN, floor(v0) - MARGIN, ceil(v1) + MARGIN


def _tile(
    view: int,
    face: int,
    R_camera_face: Array,
    box: tuple[int, int, int, int],
    corner: tuple[int, int],
    density: float,
) -> Tile:
    """A tile of a box in pixels, with its first atlas pixel at `corner`."""
    x0, x1, y0, y1 = box
    slopes = x0 / density, x1 / density, y0 / density, y1 / density
    return Tile(view, face, R_camera_face, slopes, *corner, x1 - x0, y1 - y0, density)


def _origins(tiles: Sequence[Tile], view: int) -> Float[Array, "6 4"]:
    """Atlas column and row, u0 and v1 of the tile of each face of a view's cube."""
    origins = np.zeros((6, 4))
    for t in tiles:
        if t.view == view:
            origins[t.face] = t.column, t.row, t.slopes[0], t.slopes[3]
    return origins


@numba.njit(cache=True)
def _make_lookup(
    face: Int[Array, "H W"],
    slopes: Float[Array, "H W 2"],
    origins: Float[Array, "6 4"],
    density: float,
    drawn: UInt8[Array, "h w"],
) -> Float[Array, "H W 2"]:
    """`Tile.at_slopes` of every pixel, off the atlas outside the lens; marks what is `drawn`."""
    height, width = face.shape
    lookup = np.full((height, width, 2), -9.0, np.float32)
    for y in range(height):
        for x in range(width):
            if face[y, x] >= 0:
                of = origins[face[y, x]]
                lookup[y, x, 0] = of[0] + (slopes[y, x, 0] - of[2]) * density - 0.5
                lookup[y, x, 1] = of[1] + (of[3] - slopes[y, x, 1]) * density - 0.5
                drawn[round(lookup[y, x, 1]), round(lookup[y, x, 0])] = 1
    return lookup


def _pack(sizes: Sequence[tuple[int, int]]) -> tuple[int, int, list[tuple[int, int]]]:
    """Shelf packing of rectangles: total width, total height and the first pixel of each."""
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
