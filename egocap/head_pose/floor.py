"""The vertical and the floor, from points of the surroundings and the head's usual attitude.

The head's own up, averaged over the recording, is within some 20 degrees of the vertical; the floor
is the lowest large plane near that direction. Source: RANSAC, Fischler and Bolles 1981.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.geometry import unit

TILT = np.deg2rad(30.0)  # of the floor against the head's mean up, at most
HEIGHTS = 0.4, 2.4  # m of the head above the floor
THICKNESS = 0.03  # m; points within it lie on the floor
FEWEST = 40
_TRIALS = 800
PRIOR_STD = np.deg2rad(10.0)
"""Standard deviation of the head's mean up about the vertical."""


@dataclass(frozen=True, eq=False)
class Vertical:
    """Up in the map, and the height of the floor where it was seen."""

    up: Float[Array, "3"]
    up_std: float  # rad
    source: str  # 'floor', 'imu', 'head' or 'file'
    floor: float | None = None  # height along `up` of the floor in the map, m
    floor_std: float | None = None  # m
    points: int = 0

    def transform(self, T_map_head: Float[Array, "4 4"]) -> Float[Array, "4 4"]:
        """T_world_map: z up, floor at 0, the given head above the origin and facing +x.

        Without a floor the given head is the origin.
        """
        forward = T_map_head[:3, 0]
        x = unit(forward - (forward @ self.up) * self.up)
        T = np.eye(4)
        T[:3, :3] = np.stack([x, np.cross(self.up, x), self.up])
        T[:3, 3] = -T[:3, :3] @ T_map_head[:3, 3]
        if self.floor is not None:
            T[2, 3] = -self.floor
        return T


def find_floor(
    points: Float[Array, "P 3"], heads: Float[Array, "T 4 4"], seed: int = 0
) -> Vertical | None:
    """The floor's plane; None where too few points agree on one."""
    prior = mean_up(heads)
    above = heads[:, :3, 3]
    best = _sampled(points, prior, above, np.random.default_rng(seed))
    if best is None:
        return None
    normal, height = best
    for _ in range(8):
        on = np.abs(points @ normal - height) < THICKNESS
        if on.sum() < FEWEST:
            return None
        normal, height = _fitted(points[on], prior)
    return _described(points[on], normal, height)


def mean_up(heads: Float[Array, "T 4 4"]) -> Float[Array, "3"]:
    """The head's own up, averaged."""
    return unit(heads[:, :3, 2].mean(0))


def _sampled(
    points: Float[Array, "P 3"], prior: Float[Array, "3"], above: Float[Array, "T 3"],
    rng: np.random.Generator,
) -> tuple[Float[Array, "3"], float] | None:  # fmt: skip
    """The plane through three points that most points lie on, below all heads."""
    if len(points) < FEWEST:
        return None
    corners = points[rng.integers(len(points), size=(_TRIALS, 3))]
    normals = unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    normals *= np.where(normals @ prior < 0, -1.0, 1.0)[:, None]
    heights = (normals * corners[:, 0]).sum(1)
    clear = above @ normals.T - heights  # (T, trials)
    fits = normals @ prior > np.cos(TILT)
    fits &= (np.median(clear, 0) > HEIGHTS[0]) & (np.median(clear, 0) < HEIGHTS[1])
    if not fits.any():
        return None
    normals, heights = normals[fits], heights[fits]
    apart = points @ normals.T - heights
    support = (np.abs(apart) < THICKNESS).sum(0) - (apart < -3 * THICKNESS).sum(0)
    best = int(support.argmax())
    return (normals[best], float(heights[best])) if support[best] >= FEWEST else None


def _fitted(
    points: Float[Array, "n 3"], prior: Float[Array, "3"]
) -> tuple[Float[Array, "3"], float]:
    centre = points.mean(0)
    normal = np.linalg.eigh((points - centre).T @ (points - centre))[1][:, 0]
    normal = normal if normal @ prior > 0 else -normal
    return normal, float(normal @ centre)


def _described(points: Float[Array, "n 3"], normal: Float[Array, "3"], height: float) -> Vertical:
    """The plane with the standard errors of its direction and height."""
    off = points @ normal - height
    sigma = max(float(np.sqrt((off**2).mean())), 1e-4)
    spread = np.linalg.eigvalsh(np.cov((points - np.outer(off, normal)).T))[1:]
    n = len(points)
    return Vertical(normal, float(sigma * np.sqrt((1 / (n * spread)).sum())), "floor", height,
                    float(sigma / np.sqrt(n)), n)  # fmt: skip


def upright(heads: Float[Array, "T 4 4"]) -> Vertical:
    """The head's mean up as the vertical, where nothing better is known."""
    return Vertical(mean_up(heads), PRIOR_STD, "head")


def on_floor(points: Float[Array, "P 3"], found: Vertical) -> Bool[Array, "P"]:
    """Whether points lie on the floor."""
    return np.abs(points @ found.up - (found.floor or 0.0)) < THICKNESS
