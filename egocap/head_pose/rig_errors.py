"""What errors of a rig do to the floor that two of its views agree on.

A patch of the floor lies on a ray of one view, and is matched in another one. To a rig with errors
it seems higher or lower than it is; the heights of all patches tilt, raise or lower the plane.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.geometry import transform
from egocap.head_pose.floor import CLEAR, FARTHEST, STEEP, Floor, Pictured
from egocap.odometry.self_calibration import LAG, PARAMETERS, PRIOR, READOUT, corrected
from egocap.odometry.views import Motion, Views

SCALE_STD = 0.005
"""Share by which a rig file may err in how far the cameras are apart, which pictures cannot tell,
and heights with it: 1 mm in 20 cm."""
FRAMES, GRID = 4, 36  # most that are looked at; px between patches
_STEP_M = 1e-3


def floor_errors(
    views: Views, frames: list[tuple[Float[Array, "4 4"], Pictured]], floor: Floor,
    covariance: Float[Array, "Q Q"],
) -> tuple[float, float]:  # fmt: skip
    """Standard deviations of a floor's direction [rad] and height [m] by errors of the rig.

    `frames`: T_map_head and pictures; `covariance`: of `PARAMETERS`, view by view.
    """
    some = np.unique(np.linspace(0, len(frames) - 1, FRAMES).astype(int))
    around, places, heights, depths = _around(views), [], [], []
    for T, frame in (frames[i] for i in some):
        up, depth = T[:3, :3].T @ floor.normal, float(T[:3, 3] @ floor.normal) - floor.height
        depths.append(depth)
        for a in range(len(views)):
            pair = a, views.partners[a][0]
            points, rise = _heights(views, around, pair, frame.motion, up, depth)
            places.append(transform(T, points))
            heights.append(rise)
    scale = SCALE_STD * float(np.mean(depths))
    place, height = np.concatenate(places), np.concatenate(heights)
    if len(place) < 3:
        return 0.0, scale
    across = (place - place.mean(0)) @ np.linalg.svd(floor.normal[None])[2][1:].T
    plane = np.linalg.pinv(np.concatenate([across, np.ones((len(place), 1))], 1)) @ height
    variance = np.diag(plane @ covariance @ plane.T)
    return float(np.sqrt(variance[:2].sum())), float(np.hypot(np.sqrt(variance[2]), scale))


def _around(views: Views) -> list[tuple[Views, Views, float]]:
    """The views with each parameter a step smaller and larger, and both steps together."""
    now = np.zeros((len(views), len(PARAMETERS)))
    now[:, LAG] = views.lag_s or 0.0
    now[:, READOUT] = views.readout_s or 0.0
    found = []
    for v in range(len(views)):
        for i, size in enumerate(1e-2 * PRIOR):
            step = np.zeros_like(now)
            step[v, i] = size
            found.append((corrected(views, now - step), corrected(views, now + step), 2.0 * size))
    return found


def _heights(
    views: Views, around: list[tuple[Views, Views, float]], pair: tuple[int, int], motion: Motion,
    up: Float[Array, "3"], depth: float,
) -> tuple[Float[Array, "n 3"], Float[Array, "n Q"]]:  # fmt: skip
    """Places of patches on the floor (head frame), and their heights by each parameter."""
    camera = views.cameras[pair[0]]
    columns, rows = np.arange(GRID, camera.width, GRID), np.arange(GRID, camera.height, GRID)
    pixels = np.stack(np.meshgrid(columns, rows), -1).reshape(-1, 2).astype(float)
    inside = views.lens_masks[pair[0]][pixels[:, 1].astype(int), pixels[:, 0].astype(int)] > 0
    points, _, seen = _seen(views, pair, pixels, motion, up, depth)
    pixels, points = pixels[inside & seen], points[inside & seen]

    def moved(before: Views, after: Views, deeper: float = 0.0) -> Float[Array, "n 2"]:
        ends = [_seen(v, pair, pixels, motion, up, depth + sign * deeper)[1]
                for v, sign in ((before, -1.0), (after, 1.0))]  # fmt: skip
        return ends[1] - ends[0]

    by_depth = moved(views, views, _STEP_M) / (2.0 * _STEP_M)
    along = by_depth / (by_depth**2).sum(1, keepdims=True)
    rise = [(along * moved(before, after)).sum(1) / step for before, after, step in around]
    return points, np.stack(rise, 1)


def _seen(
    views: Views, pair: tuple[int, int], pixels: Float[Array, "n 2"], motion: Motion,
    up: Float[Array, "3"], depth: float,
) -> tuple[Float[Array, "n 3"], Float[Array, "n 2"], Bool[Array, "n"]]:  # fmt: skip
    """Points of the floor in pixels of one view, where the other one sees them, and whether."""
    a, b = pair
    rays, valid = views.rays(a, pixels)
    origin, rays = views.sights(
        np.full(len(rays), a), rays, views.delay(a, pixels, motion), motion.twist
    )
    down = -(rays @ up)
    reach = (depth + origin @ up) / np.where(down > STEEP, down, 1.0)
    points = origin + reach[:, None] * rays
    across = np.linalg.norm(points - (points @ up)[:, None] * up, axis=1)
    late = views.later(points, views.delay(b, pixels, motion), motion)  # as if in the same row
    where, seen = views.project(b, late)
    seen = seen & valid & (down > STEEP) & (across > CLEAR) & (across < FARTHEST)
    return points, where, seen
