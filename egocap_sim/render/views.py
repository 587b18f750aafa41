"""A rendered frame: images; labels, depth and single distances on demand."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Protocol

import cv2
import numba
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array

from egocap.cameras.camera import Camera
from egocap_sim.render.fisheye import Atlas

_STRIDE = 4  # of the columns, when the extent of a row is computed
_NEVER = 1 << 30  # lowest index of an empty range
_REACH = 20  # atlas pixels: neighbouring image pixels are up to four apart


def _fixed_point_map(lookup: Float[Array, "H W 2"], *, nearest: bool) -> tuple[Array, Array]:
    """Fixed-point map: whole pixels (H, W, 2), and an index of interpolation weights."""
    return cv2.convertMaps(lookup, None, cv2.CV_16SC2, nninterpolation=nearest)  # pyright: ignore[reportArgumentType, reportCallIssue, reportReturnType]


class Resampler:
    """Resample fisheye pixels from the atlas: colours bilinearly, labels at the nearest pixel."""

    def __init__(self, atlas: Atlas) -> None:
        self.atlas = atlas
        # Fixed-point maps (1/32 pixel) are twice as fast as float ones.
        self._linear = [_fixed_point_map(xy, nearest=False) for xy in atlas.lookup]
        self._nearest = [_fixed_point_map(xy, nearest=True)[0] for xy in atlas.lookup]
        self.ray_factor = np.ones((atlas.height, atlas.width), np.float32)
        for t in atlas.tiles:
            self.ray_factor[t.row : t.row + t.height, t.column : t.column + t.width] = (
                t.ray_length()
            )

    def colors(
        self, view: int, atlas_rgba: UInt8[Array, "h w 4"], rows: slice
    ) -> UInt8[Array, "H W 3"]:
        """Rows of a view's image, black outside the lens."""
        places, shares = (part[rows] for part in self._linear[view])
        if not len(places):
            return np.empty((0, places.shape[1], 3), np.uint8)
        return cv2.cvtColor(
            cv2.remap(atlas_rgba, places, shares, cv2.INTER_LINEAR), cv2.COLOR_RGBA2RGB
        )

    @cached_property
    def extent(self) -> Int[Array, "tiles H 4"]:
        """Atlas columns and rows (low, high, low, high) of each tile needed for each image row."""
        lookup, tiles = self.atlas.lookup, self.atlas.tiles
        extent = np.tile([_NEVER, -1, _NEVER, -1], (len(tiles), max(map(len, lookup)), 1))
        for i, t in enumerate(tiles):
            box = np.array([t.column, t.column + t.width, t.row, t.row + t.height])
            needed = _row_extent(lookup[t.view], box) + [-_REACH, _REACH + 1, -_REACH, _REACH + 1]
            needed[:, 0::2] = np.maximum(needed[:, 0::2], box[0::2])
            needed[:, 1::2] = np.minimum(needed[:, 1::2], box[1::2])
            extent[i, : len(needed)] = needed
        return extent

    def nearest(self, view: int, atlas_values: Array, outside: float, rows: slice) -> Array:
        """Rows of values at the nearest atlas pixel; `outside` beyond the lens."""
        border = cv2.BORDER_CONSTANT  # the map points off the atlas outside the lens
        return cv2.remap(  # pyright: ignore[reportCallIssue]
            atlas_values, self._nearest[view][rows], None, cv2.INTER_NEAREST,  # pyright: ignore[reportArgumentType]
            borderMode=border, borderValue=outside,
        )  # fmt: skip


@numba.njit(cache=True)
def _row_extent(lookup: Float[Array, "H W 2"], box: Int[Array, "4"]) -> Int[Array, "H 4"]:
    """Lowest and highest column and row within a box of the atlas used by each image row."""
    height, width, _ = lookup.shape
    needed = np.empty((height, 4), np.int64)
    needed[:, 0::2], needed[:, 1::2] = _NEVER, -_NEVER
    for y in range(height):
        for x in range(0, width, _STRIDE):
            column, row = int(lookup[y, x, 0]), int(lookup[y, x, 1])
            if box[0] <= column < box[1] and box[2] <= row < box[3]:
                needed[y, 0] = min(needed[y, 0], column)
                needed[y, 1] = max(needed[y, 1], column)
                needed[y, 2] = min(needed[y, 2], row)
                needed[y, 3] = max(needed[y, 3], row)
    return needed


class AtlasReader(Protocol):
    """Read labels and depth [m along a face's z axis] of the last atlas drawn."""

    def read_labels(self) -> UInt8[Array, "h w"]: ...

    def read_depth(self) -> Float[Array, "h w"]: ...

    def read_depth_at(self, at: Int[Array, "N 2"]) -> Float[Array, "N"]: ...


class Views:
    """One frame of a rig, or rows of it. All but `images` is valid until the next frame only."""

    expired = False
    """True once the next frame is drawn."""

    def __init__(
        self,
        reader: AtlasReader,
        cameras: Sequence[Camera],
        resampler: Resampler,
        atlas_rgba: UInt8[Array, "h w 4"],
        rows: Mapping[int, slice] | None = None,
    ) -> None:
        """With `rows`, images contain only these rows of these views."""
        self._reader, self._cameras, self._resampler = reader, cameras, resampler
        self._distance: Float[Array, "h w"] | None = None
        self._drawn = [slice(None) if rows is None else rows.get(v, slice(0, 0))
                       for v in range(len(resampler.atlas.lookup))]  # fmt: skip
        self._atlas: UInt8[Array, "h w 4"] | None = atlas_rgba
        self._images: tuple[UInt8[Array, "H W 3"], ...] = ()
        self._resampling = threading.Lock()

    @property
    def images(self) -> tuple[UInt8[Array, "H W 3"], ...]:
        """The image of every view, resampled when first asked for, in whichever thread."""
        with self._resampling:
            if self._atlas is not None:
                self._images = tuple(
                    self._resampler.colors(v, self._atlas, band)
                    for v, band in enumerate(self._drawn)
                )
                self._atlas = None
            return self._images

    def parts(self) -> tuple[UInt8[Array, "H W"], ...]:
        """Part label of every pixel of every view (`core.part_labels`), 0 outside the lens."""
        return tuple(self.part_rows(v, slice(None)) for v in range(len(self._drawn)))

    def part_rows(self, view: int, rows: slice) -> UInt8[Array, "h W"]:
        """Part labels of rows of one view."""
        self._require_current()
        return self._resampler.nearest(view, self._reader.read_labels(), 0, rows)

    def depth(self) -> tuple[Float[Array, "H W"], ...]:
        """Distance along each pixel's ray in metres, float32; infinite without a surface."""
        return tuple(self.depth_rows(v, slice(None)) for v in range(len(self._drawn)))

    def depth_rows(self, view: int, rows: slice) -> Float[Array, "h W"]:
        """Distances of rows of one view."""
        self._require_current()
        if self._distance is None:
            labels = self._reader.read_labels()
            distance = self._reader.read_depth() * self._resampler.ray_factor
            self._distance = np.where(labels > 0, distance, np.float32(np.inf))
        return self._resampler.nearest(view, self._distance, np.inf, rows)

    def surface_at(
        self,
        view: int,
        pixels: Float[Array, "N 2"],
        wanted: Bool[Array, "N 256"] | None = None,
    ) -> tuple[Float[Array, "N"], Int[Array, "N"]]:
        """Distance along the ray (m) and part label of the first surface at pixels of a view.

        Pixels outside the image or the lens have an infinite distance and label 0. The nearest
        atlas pixel is used. With `wanted`, distances are read only where the label is wanted at
        that pixel, which saves time; others are infinite.
        """
        self._require_current()
        pixels = np.asarray(pixels, float)
        camera = self._cameras[view]
        rays, valid = camera.ray(pixels)
        size = np.array([camera.width, camera.height])
        valid = valid & np.all((pixels >= -0.5) & (pixels < size - 0.5), -1)
        tile, xy = self._resampler.atlas.locate(view, np.where(valid[:, None], rays, [0, 0, 1.0]))
        hit = np.flatnonzero(valid & (tile >= 0))
        column, row = np.round(xy[hit]).astype(int).T
        distance, part = np.full(len(pixels), np.inf), np.zeros(len(pixels), int)
        part[hit] = self._reader.read_labels()[row, column]
        measured = part[hit] > 0
        if wanted is not None:
            measured &= wanted[hit, part[hit]]
        hit, column, row = hit[measured], column[measured], row[measured]
        z = self._reader.read_depth_at(np.stack([column, row], -1))
        distance[hit] = z * self._resampler.ray_factor[row, column]
        return distance, part

    def _require_current(self) -> None:
        if self.expired:
            raise RuntimeError("these views have expired: the renderer has drawn another frame")
