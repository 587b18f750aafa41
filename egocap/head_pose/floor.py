"""The floor: the plane on which two views of the ground agree best.

Patches of the ground are warped from one view into the other as if they lay at each height; weak
textures count together for the level, and the heights of single patches about it give the tilt.
Source: plane sweep, Collins 1996.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.geometry import unit
from egocap.odometry import patch_kernel as kernel
from egocap.odometry.surface_patches import surface_slope
from egocap.odometry.views import Motion, Views

STEEP = 0.3  # least cosine of a ray to straight down
BELOW = 0.5, 3.2  # m of the floor below the head; more than 2 m on ladders and stairs
STEP = 0.02  # m; of a coarse sweep twice as much
SPACING = 3.0  # px between a patch's samples
GRID = 12  # px between patches
CLEAR = 0.55  # m about the head's vertical, where the wearer stands
FARTHEST = 2.5  # m on the floor from the head's vertical
LEAST = 0.15  # mean correlation of a floor
NEAR = 0.15  # m about the level, in which single patches are searched
SETTLED, MOST_SWEEPS = np.deg2rad(0.5), 6
"""Angle of a floor from the last sweep's direction, and how many fine sweeps may reach it."""
AGAIN = 0.4  # m about the last level, of a fine sweep
CLEAR_PEAK = 0.7, 0.08  # correlation of such a patch, and its lead over the median
LOSS = 0.03  # m; width of the loss of the plane through the patches
ALIKE = 10.0  # patches with the same error: neighbours, and the same place in several frames
_FEWEST, _FEWEST_DEPTHS = 20, 10  # patches; depths of a sweep

Image = UInt8[Array, "H W"]


@dataclass(frozen=True, eq=False)
class Sweep:
    """Patches of one picture at depths below the head."""

    depths: Float[Array, "H"]  # m
    scores: Float[Array, "n H"]  # correlations with the other view; -1: none
    points: Float[Array, "n H 3"]  # head frame


@dataclass(frozen=True, eq=False)
class Floor:
    """A plane of the map: points with normal . p = height."""

    normal: Float[Array, "3"]
    normal_std: float  # rad
    height: float  # m
    height_std: float  # m

    def wider(self, tilt: float, raised: float) -> Floor:
        """The same with further, independent deviations of its normal [rad] and height [m]."""
        return replace(self, normal_std=float(np.hypot(self.normal_std, tilt)),
                       height_std=float(np.hypot(self.height_std, raised)))  # fmt: skip


@dataclass(frozen=True, eq=False)
class Pictured:
    """Grey pictures of a frame, and how the head moved while they were taken."""

    images: tuple[Image | None, ...]
    motion: Motion


def sweeps(
    views: Views, frame: Pictured, up_head: Float[Array, "3"], depths: Float[Array, "H"]
) -> list[Sweep]:
    """The sweeps of every view that has a picture beside its partner's."""
    pairs = [(a, views.partners[a][0]) for a in range(len(views))]
    return [_sweep(views, a, b, frame, up_head, depths) for a, b in pairs
            if frame.images[a] is not None and frame.images[b] is not None]  # fmt: skip


def _sweep(
    views: Views, a: int, b: int, frame: Pictured, up: Float[Array, "3"],
    depths: Float[Array, "H"],
) -> Sweep:  # fmt: skip
    image, other, motion = frame.images[a], frame.images[b], frame.motion
    assert image is not None and other is not None
    height, width = image.shape
    columns, rows = np.arange(GRID, width - GRID, GRID), np.arange(GRID, height - GRID, GRID)
    grid = np.stack(np.meshgrid(columns, rows), -1).reshape(-1, 2)
    pixels = grid[views.lens_masks[a][grid[:, 1], grid[:, 0]] > 0].astype(float)
    rays, slope, _, _ = views.rays_and_derivative(a, pixels)
    origin, rays = views.sights(
        np.full(len(rays), a), rays, views.delay(a, pixels, motion), motion.twist
    )
    down = -(rays @ up) > STEEP
    pixels, origin, rays, slope = pixels[down], origin[down], rays[down], slope[down]
    reach = -(depths + (origin @ up)[:, None]) / (rays @ up)[:, None]  # (n, H), m along the ray
    points = origin[:, None] + reach[..., None] * rays[:, None]
    across = np.linalg.norm(points - (points @ up)[..., None] * up, axis=-1)
    late = views.later(points, views.delay(b, pixels, motion), motion)  # as if in the same row
    where, J, seen = views.project_jacobian(b, late)
    flat = surface_slope(rays, slope, np.ones(len(rays)), np.tile(up, (len(rays), 1)))
    A = J @ (flat[:, None] * reach[..., None, None])
    seen = seen & (across > CLEAR) & (across < FARTHEST)
    return Sweep(depths, kernel.correlations(image, pixels, other, where, A, seen, SPACING), points)


def find_floor(
    views: Views, frames: list[tuple[Float[Array, "4 4"], Pictured]], up: Float[Array, "3"]
) -> Floor | None:  # fmt: skip
    """The floor in the map; None: no level stands out.

    `frames`: T_map_head and pictures of some frames spread over the recording; `up` within some
    twenty degrees. The floor is swept again along its own normal until that settles.
    """
    floor = _swept(views, frames, up)
    for _ in range(MOST_SWEEPS):
        if floor is None:
            break
        up, floor = floor.normal, _swept(views, frames, floor.normal, floor.height)
        if floor is not None and floor.normal @ up > np.cos(SETTLED):
            break
    return floor


def _swept(
    views: Views, frames: list[tuple[Float[Array, "4 4"], Pictured]], up: Float[Array, "3"],
    near: float | None = None,
) -> Floor | None:  # fmt: skip
    """The floor by one sweep along `up`: coarsely of all depths, or about a height in the map."""
    if not frames:
        return None
    heads = np.array([T[:3, 3] @ up for T, _ in frames])
    levels = heads.mean() - np.arange(BELOW[0] - 0.1, BELOW[1] + 0.1, STEP)
    depths = [np.arange(*BELOW, 2.0 * STEP)] * len(frames)
    if near is not None:
        every, levels = np.arange(*BELOW, STEP), levels[np.abs(levels - near) < AGAIN]
        depths = [every[np.abs(head - every - near) < AGAIN] for head in heads]
    found = [(T, sweeps(views, frame, T[:3, :3].T @ up, own) if len(own) > _FEWEST_DEPTHS else [])
             for (T, frame), own in zip(frames, depths, strict=True)]  # fmt: skip
    table = np.array([
        _mean_score(own, head - levels) for head, (_, own) in zip(heads, found, strict=True)
    ])  # fmt: skip
    mean = table.mean(0)
    best = int(mean.argmax()) if len(levels) else 0
    if not 0 < best < len(levels) - 1 or mean[best] < LEAST:
        return None
    own = np.array([_peak(row, levels, best) for row in table])
    own = own[np.isfinite(own)]
    std = float(own.std() / np.sqrt(len(own))) if len(own) > 2 else STEP
    level = Floor(up, np.inf, _peak(mean, levels, best), max(std, 1e-3))
    points = [p @ T[:3, :3].T + T[:3, 3] for T, s in found
              for p in _ground(s, float(T[:3, 3] @ up) - level.height)]  # fmt: skip
    return _tilted(level, np.concatenate(points)) if points else level


def _mean_score(found: list[Sweep], depths: Float[Array, "L"]) -> Float[Array, "L"]:
    """Mean correlation of one frame's patches at depths below the head."""
    if not found:
        return np.zeros(len(depths))
    total = sum(np.clip(s.scores, 0.0, 1.0).sum(0) for s in found)
    count = max(sum(len(s.scores) for s in found), _FEWEST)
    return np.interp(depths, found[0].depths, total / count, left=0.0, right=0.0)


def _ground(found: list[Sweep], depth: float) -> list[Float[Array, "m 3"]]:
    """Points (head frame) of the patches that match clearly near a depth."""
    points = []
    for sweep in found:
        near = np.flatnonzero(np.abs(sweep.depths - depth) < NEAR)
        scores = sweep.scores[:, near]
        at = scores.argmax(1)
        best = scores.max(1)
        good = (at > 0) & (at < len(near) - 1) & (best > CLEAR_PEAK[0])
        good &= best - np.median(scores, axis=1) > CLEAR_PEAK[1]
        rows, at = np.flatnonzero(good), at[good]
        left, middle, right = (scores[rows, at + k] for k in (-1, 0, 1))
        share = 0.5 * (left - right) / np.minimum(left - 2.0 * middle + right, -1e-9)
        step = sweep.points[rows, near[at] + 1] - sweep.points[rows, near[at]]
        points.append(sweep.points[rows, near[at]] + np.clip(share, -1, 1)[:, None] * step)
    return points


def _tilted(level: Floor, points: Float[Array, "n 3"]) -> Floor:
    """The plane through the patches: robust least squares of their heights about the level."""
    if len(points) < 4 * _FEWEST:
        return level
    across = np.linalg.svd(level.normal[None])[2][1:]
    centre = np.median(points @ across.T, axis=0)
    A = np.concatenate([points @ across.T - centre, np.ones((len(points), 1))], 1)
    height = points @ level.normal - level.height
    x, weight = np.zeros(3), np.ones(len(points))
    for _ in range(15):
        x = np.linalg.solve((A * weight[:, None]).T @ A, A.T @ (weight * height))
        weight = 1.0 / (1.0 + ((height - A @ x) / LOSS) ** 2) ** 2
    off = height - A @ x
    variance = ALIKE * (weight * off**2).sum() / weight.sum()
    covariance = variance * np.linalg.inv((A * weight[:, None]).T @ A)
    normal = unit(level.normal - x[:2] @ across)
    on = centre @ across + (level.height + x[2]) * level.normal
    return Floor(normal, float(np.sqrt(np.trace(covariance[:2, :2]))), float(on @ normal),
                 float(max(np.sqrt(covariance[2, 2]), 1e-3)))  # fmt: skip


def _peak(scores: Float[Array, "H"], levels: Float[Array, "H"], near: int) -> float:
    """Maximum near an index, by a parabola; nan where it is none."""
    low = max(near - 4, 1)
    at = low + int(scores[low : near + 5].argmax())
    if not 0 < at < len(scores) - 1:
        return float("nan")
    left, middle, right = scores[at - 1 : at + 2]
    bend = left - 2.0 * middle + right
    return float(levels[at] - STEP * 0.5 * (left - right) / bend) if bend < 0 else float("nan")
