"""What a frame looks like: images at once; labels, depth and single distances when asked."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray as Array

from egocap_sim.fisheye import Atlas

if TYPE_CHECKING:
    from egocap_sim.render.renderer import FisheyeRenderer


class Resampler:
    """Looks fisheye pixels up in the atlas: colours between four pixels, labels at the nearest."""

    def __init__(self, atlas: Atlas) -> None:
        self.atlas = atlas
        # Fixed-point maps (1/32 pixel) are twice as fast as float ones.
        self._linear = [
            cv2.convertMaps(xy, None, cv2.CV_16SC2)  # pyright: ignore[reportArgumentType, reportCallIssue]
            for xy in atlas.lookup
        ]
        self._nearest = [
            np.where(inside[..., None], np.round(xy), -1).astype(np.int16)
            for xy, inside in zip(atlas.lookup, atlas.inside, strict=True)
        ]
        self.ray_factor = np.ones((atlas.height, atlas.width), np.float32)
        for t in atlas.tiles:
            self.ray_factor[t.row : t.row + t.height, t.column : t.column + t.width] = (
                t.ray_length()
            )

    def colors(self, atlas_rgba: UInt8[Array, "h w 4"]) -> tuple[UInt8[Array, "H W 3"], ...]:
        """Images of all views, black outside the lens."""
        return tuple(
            cv2.cvtColor(
                cv2.remap(atlas_rgba, places, shares, cv2.INTER_LINEAR), cv2.COLOR_RGBA2RGB
            )
            for places, shares in self._linear
        )

    def nearest(self, view: int, atlas_values: Array, outside: float) -> Array:
        """Values (H, W) at the nearest atlas pixel; `outside` where the lens sees nothing."""
        border = cv2.BORDER_CONSTANT  # outside the lens the map points at (-1, -1)
        return cv2.remap(  # pyright: ignore[reportCallIssue]
            atlas_values, self._nearest[view], None, cv2.INTER_NEAREST,  # pyright: ignore[reportArgumentType]
            borderMode=border, borderValue=outside,
        )  # fmt: skip


class Views:
    """One frame of a rig. `images` stay; the rest is only there until the renderer's next frame."""

    def __init__(
        self, renderer: FisheyeRenderer, resampler: Resampler, atlas_rgba: UInt8[Array, "h w 4"]
    ) -> None:
        self._renderer, self._resampler = renderer, resampler
        self.images: tuple[UInt8[Array, "H W 3"], ...] = resampler.colors(atlas_rgba)

    def parts(self) -> tuple[UInt8[Array, "H W"], ...]:
        """Part label of every pixel of every view (`egocap_sim.parts`), 0 outside the lens."""
        self._require_current()
        labels = self._renderer.read_labels()
        n = len(self.images)
        return tuple(self._resampler.nearest(v, labels, 0) for v in range(n))

    def depth(self) -> tuple[Float[Array, "H W"], ...]:
        """Distance along each pixel's ray in metres, float32; infinite where it hits nothing."""
        self._require_current()
        labels = self._renderer.read_labels()
        distance = self._renderer.read_depth() * self._resampler.ray_factor
        distance = np.where(labels > 0, distance, np.float32(np.inf))
        n = len(self.images)
        return tuple(self._resampler.nearest(v, distance, np.inf) for v in range(n))

    def surface_at(
        self, view: int, pixels: Float[Array, "N 2"]
    ) -> tuple[Float[Array, "N"], Int[Array, "N"]]:
        """Distance along the ray (m) and part label of what is first hit at pixels of a view.

        Pixels outside the image or the lens give an infinite distance and label 0. Cheap for a few
        dozen pixels; what counts is the nearest atlas pixel.
        """
        self._require_current()
        pixels = np.asarray(pixels, float)
        camera = self._renderer.rig.mounts[view].camera
        rays, valid = camera.ray(pixels)
        size = np.array([camera.width, camera.height])
        valid = valid & np.all((pixels >= -0.5) & (pixels < size - 0.5), -1)
        tile, xy = self._resampler.atlas.locate(view, np.where(valid[:, None], rays, [0, 0, 1.0]))
        hit = np.flatnonzero(valid & (tile >= 0))
        column, row = np.round(xy[hit]).astype(int).T
        distance, part = np.full(len(pixels), np.inf), np.zeros(len(pixels), int)
        part[hit] = self._renderer.read_labels()[row, column]
        z = self._renderer.read_depth_at(np.stack([column, row], -1))
        distance[hit] = z * self._resampler.ray_factor[row, column]
        distance[part == 0] = np.inf
        return distance, part

    def _require_current(self) -> None:
        if not self._renderer.current(self):
            raise RuntimeError("these views are gone: the renderer has drawn another frame")
