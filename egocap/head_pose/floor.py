"""The height of the floor: the level plane on which two views of it agree best.

Patches of the ground are warped from one view into the other as if they lay at each height; weak
textures count together. Source: plane sweep, Collins 1996.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.odometry import patch_kernel as kernel
from egocap.odometry.surface_patches import surface_slope
from egocap.odometry.views import Views

BELOW = 0.5, 2.3  # m of the floor below the head
STEP = 0.02  # m
SPACING = 3.0  # px between a patch's samples
GRID = 12  # px between patches
CLEAR = 0.55  # m about the head's vertical, where the wearer stands
FARTHEST = 2.5  # m on the floor from the head's vertical
LEAST = 0.15  # mean correlation of a floor
_FEWEST = 20  # patches

Image = UInt8[Array, "H W"]


def floor_scores(
    views: Views, images: tuple[Image | None, ...], up_head: Float[Array, "3"],
) -> tuple[Float[Array, "H"], Float[Array, "H"]]:  # fmt: skip
    """Depths below the head [m] and the sum of the patches' correlations there, of one frame."""
    depths = np.arange(*BELOW, STEP)
    total, count = np.zeros(len(depths)), 0
    for a, image in enumerate(images):
        b = views.partners[a][0]
        if image is None or images[b] is None:
            continue
        scores = _pair_scores(views, a, b, image, images[b], up_head, depths)
        total += np.clip(scores, 0.0, 1.0).sum(0)
        count += len(scores)
    return depths, total / max(count, _FEWEST)


def _pair_scores(
    views: Views, a: int, b: int, image: Image, other: Image | None, up: Float[Array, "3"],
    depths: Float[Array, "H"],
) -> Float[Array, "n H"]:  # fmt: skip
    assert other is not None
    height, width = image.shape
    columns, rows = np.arange(GRID, width - GRID, GRID), np.arange(GRID, height - GRID, GRID)
    grid = np.stack(np.meshgrid(columns, rows), -1).reshape(-1, 2)
    inside = views.lens_masks[a][grid[:, 1], grid[:, 0]] > 0
    pixels = grid[inside].astype(float)
    rays, _ = views.rays(a, pixels)
    steep = -(rays @ up)
    pixels, rays, steep = pixels[steep > 0.3], rays[steep > 0.3], steep[steep > 0.3]
    slope, _ = views.ray_derivative(a, rays)
    origin = views.centres[a]
    reach = (depths + origin @ up) / steep[:, None]  # (n, H), metres along the ray
    points = origin + reach[..., None] * rays[:, None]
    across = np.linalg.norm(points - (points @ up)[..., None] * up, axis=-1)
    where, J, seen = views.project_jacobian(b, points)
    flat = np.tile(up, (len(rays), 1))
    A = J @ (surface_slope(rays, slope, np.ones(len(rays)), flat)[:, None] * reach[..., None, None])
    seen = seen & (across > CLEAR) & (across < FARTHEST)
    return kernel.correlations(image, pixels, other, where, A, seen, SPACING)


def find_floor(
    views: Views, frames: list[tuple[Float[Array, "4 4"], tuple[Image | None, ...]]],
    up: Float[Array, "3"],
) -> tuple[float, float] | None:  # fmt: skip
    """Height of the floor along `up` in the map and its standard error [m]; None: no clear peak.

    `frames`: T_map_head and the pictures of some frames spread over the recording.
    """
    heads = np.array([T[:3, 3] @ up for T, _ in frames])
    levels = heads.mean() - np.arange(BELOW[0] - 0.1, BELOW[1] + 0.1, STEP)
    scores = []
    for head, (T, images) in zip(heads, frames, strict=True):
        depths, found = floor_scores(views, images, T[:3, :3].T @ up)
        scores.append(np.interp(head - levels, depths, found, left=0.0, right=0.0))
    table = np.array(scores)
    mean = table.mean(0)
    best = int(mean.argmax())
    if not 0 < best < len(levels) - 1 or mean[best] < LEAST:
        return None
    own = np.array([_peak(row, levels, best) for row in table])
    own = own[np.isfinite(own)]
    std = float(own.std() / np.sqrt(len(own))) if len(own) > 2 else STEP
    return _peak(mean, levels, best), max(std, 1e-3)


def _peak(scores: Float[Array, "H"], levels: Float[Array, "H"], near: int) -> float:
    """Maximum near an index, by a parabola; nan where it is none."""
    low = max(near - 4, 1)
    at = low + int(scores[low : near + 5].argmax())
    if not 0 < at < len(scores) - 1:
        return float("nan")
    left, middle, right = scores[at - 1 : at + 2]
    bend = left - 2.0 * middle + right
    return float(levels[at] - STEP * 0.5 * (left - right) / bend) if bend < 0 else float("nan")
