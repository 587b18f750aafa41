"""The rays of all pixels of a rig's views, in tiles, and what colours images have along them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int, Int32, Shaped, UInt8
from numpy import ndarray as Array

from egocap.cameras.camera import Camera
from egocap.cameras.rig import Rig
from egocap.errors import InputError
from egocap.geometry import unit

TILE = 8
"""Width and height of a tile in pixels."""
PosedFrames = Sequence[tuple[Sequence[UInt8[Array, "H W 3"]], Float[Array, "37"]]]
"""RGB images of all views and the pose, frame by frame."""


@dataclass(frozen=True, eq=False)
class ImageRays:
    """Rays of the valid pixels of every view, tile after tile; head frame, metres."""

    size: tuple[int, int]  # width, height of each view
    origins: Float[Array, "V 3"]  # of each view
    view: Int32[Array, "P"]
    pixel: Int32[Array, "P 2"]  # u, v
    direction: Float[Array, "P 3"]  # unit
    tile: Int32[Array, "P"]
    tile_view: Int32[Array, "N"]
    tile_axis: Float[Array, "N 3"]  # unit; the middle of the tile's rays
    tile_angle: Float[Array, "N"]  # rad; the farthest ray from it

    def __len__(self) -> int:
        return len(self.view)


def image_rays(rig: Rig, width: int | None = None, height: int | None = None) -> ImageRays:
    """Rays through the pixel centres of a rig's images, scaled to width x height when given.

    Raises InputError when the views differ in size.
    """
    if width is not None and height is not None:
        rig = rig.resized(width, height)
    sizes = {(camera.width, camera.height) for camera in rig.cameras}
    if len(sizes) > 1:
        raise InputError(f"the rig's views have the sizes {sorted(sizes)}", valid="one size")
    ((width, height),) = sizes
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    pixels = np.stack([u, v], -1)
    origins, directions, valid = rig.rays(np.tile(pixels.astype(float), (len(rig.mounts), 1, 1, 1)))
    columns = -(-width // TILE)
    tile_of = (v // TILE) * columns + u // TILE
    chunks = []
    for view in range(len(rig.mounts)):
        order = np.argsort(tile_of[valid[view]], kind="stable")
        chunks.append(
            (
                np.full(len(order), view),
                pixels[valid[view]][order],
                directions[view][valid[view]][order],
                tile_of[valid[view]][order] + view * (tile_of.max() + 1),
            )
        )
    view, pixel, direction, tile = (np.concatenate(c) for c in zip(*chunks, strict=True))
    _, tile = np.unique(tile, return_inverse=True)
    sums = np.stack([np.bincount(tile, direction[:, k]) for k in range(3)], -1)
    axis = unit(sums)
    cosines = np.clip((direction * axis[tile]).sum(-1), -1.0, 1.0)
    lowest = np.ones(len(axis))
    np.minimum.at(lowest, tile, cosines)
    first = np.searchsorted(tile, np.arange(len(axis)))
    return ImageRays(
        (width, height), origins, view.astype(np.int32), pixel.astype(np.int32), direction,
        tile.astype(np.int32), view[first].astype(np.int32), axis, np.arccos(lowest) + 1e-6,
    )  # fmt: skip


def ray_numbers(rays: ImageRays) -> Int[Array, "V H W"]:
    """The ray of each pixel; -1 without one."""
    return ray_image(rays, np.arange(len(rays)), -1).astype(int)


def pixel_angle(camera: Camera) -> float:
    """Angle between the rays of two neighbouring pixels in a picture's middle, radians."""
    middle = np.array([[0.5, 0.5], [1.5, 0.5]]) + (camera.width // 2, camera.height // 2)
    a, b = camera.ray(middle)[0]
    return float(np.arccos(a @ b))


def require_pictures(
    rig: Rig, images: Sequence[UInt8[Array, "H W 3"]], reduced: tuple[int, int] | None = None
) -> None:
    """Raise InputError unless there is one picture a view, of the aspect of the rig's.

    Pictures of the size `reduced` are accepted too.
    """
    if len(images) != len(rig.mounts):
        raise InputError(f"{len(images)} images", valid=f"{len(rig.mounts)}, one a view")
    for mount, image in zip(rig.mounts, images, strict=True):
        camera, (height, width) = mount.camera, image.shape[:2]
        if (width, height) == reduced:
            continue
        if abs(width * camera.height - height * camera.width) > max(camera.width, camera.height):
            raise InputError(
                f"a picture of {width} x {height} in view '{mount.name}'",
                valid=f"the aspect of the rig's, {camera.width} x {camera.height}",
            )


def ray_colours(
    rays: ImageRays, images: Sequence[UInt8[Array, "H W 3"]], gain: Float[Array, "3"] | None = None
) -> Float32[Array, "P 3"]:
    """Hue, saturation, value in [0, 1] along every ray, from RGB images of any size.

    Larger images are averaged over the pixels they are scaled to. Channels are divided by a `gain`
    where it is given, which can bring values above 1. Raises InputError when there is
    not one image a view.
    """
    import cv2

    if len(images) != len(rays.origins):
        raise InputError(f"{len(images)} images", valid=f"{len(rays.origins)}, one a view")
    planes = []
    for image in images:
        if image.shape[1::-1] != rays.size:
            image = cv2.resize(image, rays.size, interpolation=cv2.INTER_AREA)
        scaled = np.asarray(image, np.float32) / np.float32(255.0)
        if gain is not None:
            scaled = scaled / np.asarray(gain, np.float32)
        planes.append(cv2.cvtColor(scaled, cv2.COLOR_RGB2HSV))
    hsv = np.stack(planes)[rays.view, rays.pixel[:, 1], rays.pixel[:, 0]]
    hsv[:, 0] /= 360.0
    return np.ascontiguousarray(hsv, np.float32)


def ray_image(
    rays: ImageRays, values: Shaped[Array, "P ..."], background: float = np.nan
) -> Float[Array, "V H W ..."]:
    """Values of rays back in image form; pixels without a ray get `background`."""
    width, height = rays.size
    plane = np.full((len(rays.origins), height, width, *values.shape[1:]), background, float)
    plane[rays.view, rays.pixel[:, 1], rays.pixel[:, 0]] = values
    return plane
