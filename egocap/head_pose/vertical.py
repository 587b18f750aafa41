"""Up in a map of points, from the planes of rooms near the head's usual attitude, and the floor.

The head's own up, averaged over the recording, is some 20 degrees from the vertical at most. Planes
near that direction are floors and tables, planes across it walls; up is what they agree on.
Source: RANSAC, Fischler and Bolles 1981; Manhattan directions, Coughlan and Yuille 1999.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.geometry import unit
from egocap.head_pose.floor import Floor, Pictured, find_floor
from egocap.head_pose.rig_errors import floor_errors
from egocap.odometry.views import Views

TILT = np.deg2rad(25.0)  # of up against the head's mean up, at most
THICKNESS = 0.02  # m; points within it lie on a plane
FEWEST = 30  # points of a plane
MOST_STD = np.deg2rad(2.0)  # of up, for planes to decide
MEAN_UP_STD = np.deg2rad(10.0)
"""Standard deviation of the head's mean up about the vertical."""
BENT = np.deg2rad(0.7)  # standard deviation of a plane's direction: things stand on floors
DIFFERENT, MOST = np.deg2rad(5.0), 4
"""Angle between directions of up that are tried, and how many."""
LOSS = np.deg2rad(1.5)  # width of the loss; slopes and slanted things are outliers
_PLANES, _TRIALS = 16, 400


@dataclass(frozen=True, eq=False)
class Vertical:
    """Up in the map, and the height of the floor where it is known."""

    up: Float[Array, "3"]
    up_std: float  # rad
    source: str  # 'the floor', 'planes' or 'head'
    floor: float | None = None  # height of the floor along `up` in the map, m
    floor_std: float | None = None  # m

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

    def wider(self, tilt: float, raised: float) -> Vertical:
        """The same with further, independent deviations of up [rad] and of the floor's height."""
        assert self.floor_std is not None
        return replace(self, up_std=float(np.hypot(self.up_std, tilt)),
                       floor_std=float(np.hypot(self.floor_std, raised)))  # fmt: skip

    def with_floor(self, floor: Floor) -> Vertical:
        """The floor's height, and its normal where that is more certain than up is without it."""
        found = replace(self, floor=floor.height, floor_std=floor.height_std)
        if floor.normal_std > self.up_std:
            return replace(found, floor=float(floor.height / (floor.normal @ self.up)))
        return replace(found, up=floor.normal, up_std=floor.normal_std, source="the floor")


@dataclass(frozen=True, eq=False)
class _Plane:
    normal: Float[Array, "3"]
    information: Float[Array, "3 3"]  # of the normal, 1 / rad^2


def find_vertical(
    views: Views, points: Float[Array, "P 3"], heads: Float[Array, "T 4 4"],
    frames: list[tuple[Float[Array, "4 4"], Pictured]], inertial: Vertical | None = None,
    rig_covariance: Float[Array, "Q Q"] | None = None,
) -> Vertical:  # fmt: skip
    """Up, and the floor that pictures show from there.

    Of directions that planes agree on, and the head's mean up, it is the likeliest from which a
    floor is found, else the likeliest; an `inertial` one where that is more certain. `frames`:
    T_map_head and pictures of some. What is unknown of the rig (None: it is exact) makes the floor
    less certain, and planes alike; nothing that an IMU feels.
    """
    likely = likely_verticals(points, heads)
    if inertial is not None and inertial.up_std < likely[0].up_std:
        likely = [inertial]
    for vertical in likely:
        floor = find_floor(views, frames, vertical.up)
        if floor is None:
            continue
        errors = 0.0, 0.0
        if rig_covariance is not None:
            errors = floor_errors(views, frames, floor, rig_covariance)
        if vertical is inertial:
            return vertical.with_floor(floor.wider(*errors))
        return vertical.with_floor(floor).wider(*errors)
    return likely[0]


def likely_verticals(
    points: Float[Array, "P 3"], heads: Float[Array, "T 4 4"], seed: int = 0
) -> list[Vertical]:
    """Directions of up from planes, the likeliest first, and last the head's mean up."""
    prior = unit(heads[:, :3, 2].mean(0))
    planes = _planes(points, np.random.default_rng(seed))
    starts: list[Float[Array, "3"]] = []
    for start in sorted(_candidates(planes, prior), key=lambda up: -_support(planes, up)):
        if all(start @ other < np.cos(DIFFERENT) for other in starts):
            starts.append(start)
    found = [Vertical(*_agreed(planes, prior, start), "planes") for start in starts[:MOST]]
    head = Vertical(prior, MEAN_UP_STD, "head")
    return [*found, head] if found and found[0].up_std < MOST_STD else [head]


def _support(planes: list[_Plane], up: Float[Array, "3"]) -> float:
    """How many planes are level or upright, with a loss."""
    return sum(1.0 / (1.0 + (_off(p, up) / LOSS) ** 2) for p in planes)


def _agreed(
    planes: list[_Plane], prior: Float[Array, "3"], up: Float[Array, "3"]
) -> tuple[Float[Array, "3"], float]:
    """Up near a start that floors are along and walls across, its standard deviation [rad]."""
    H = np.eye(2)
    for _ in range(10):
        across = np.linalg.svd(up[None])[2][1:]
        H, g = np.eye(2) / MEAN_UP_STD**2, across @ (up - prior) / MEAN_UP_STD**2
        for p in planes:
            weight = 1.0 / (1.0 + (_off(p, up) / LOSS) ** 2) ** 2
            if _is_wall(p, up):  # normal . up = 0
                J, W = across @ p.normal, weight * (up @ p.information @ up)
                H, g = H + W * np.outer(J, J), g + W * J * (p.normal @ up)
            else:
                n = p.normal * np.sign(p.normal @ up)
                W = weight * across @ p.information @ across.T
                H, g = H + W, g + W @ (across @ (up - n))
        up = unit(up - np.linalg.solve(H, g) @ across)
    return up, float(np.sqrt(np.trace(np.linalg.inv(H))))


def _is_wall(plane: _Plane, up: Float[Array, "3"]) -> bool:
    return abs(float(plane.normal @ up)) < 0.7


def _off(plane: _Plane, up: Float[Array, "3"]) -> float:
    """Angle of a plane from the nearer one of level and upright [rad]."""
    cosine = min(abs(float(plane.normal @ up)), 1.0)
    return float(min(np.arccos(cosine), np.arcsin(cosine)))


def _candidates(planes: list[_Plane], prior: Float[Array, "3"]) -> list[Float[Array, "3"]]:
    """Normals of floors, and directions across two walls, near the head's mean up."""
    found = [p.normal for p in planes]
    found += [unit(np.cross(p.normal, q.normal)) for p in planes for q in planes
              if abs(p.normal @ q.normal) < 0.8]  # fmt: skip
    found = [n * (1.0 if n @ prior > 0 else -1.0) for n in found]
    return [n for n in found if n @ prior > np.cos(TILT)]


def _planes(points: Float[Array, "P 3"], rng: np.random.Generator) -> list[_Plane]:
    """The planes with the most points, one after the other."""
    found: list[_Plane] = []
    left = points[np.isfinite(points).all(1)]
    while len(found) < _PLANES and len(left) >= FEWEST:
        on = _largest(left, rng)
        if on.sum() < FEWEST:
            break
        found.append(_plane(left[on]))
        left = left[~on]
    return found


def _largest(points: Float[Array, "P 3"], rng: np.random.Generator) -> Array:
    """Points on the plane that most lie on, through three that are near each other."""
    first = points[rng.integers(len(points), size=_TRIALS)]
    near = points[rng.integers(len(points), size=(_TRIALS, 60))]
    apart = np.linalg.norm(near - first[:, None], axis=2)
    order = np.argsort(np.where(apart < 0.05, np.inf, apart), axis=1)[:, [0, 3]]
    pair = np.take_along_axis(near, order[:, :, None], 1)
    normals = unit(np.cross(pair[:, 0] - first, pair[:, 1] - first))
    off = np.abs(points @ normals.T - (normals * first).sum(1))
    on = off[:, int((off < THICKNESS).sum(0).argmax())] < THICKNESS
    for _ in range(3):
        if on.sum() < 3:
            break
        centre = points[on].mean(0)
        normal = np.linalg.eigh((points[on] - centre).T @ (points[on] - centre))[1][:, 0]
        on = np.abs((points - centre) @ normal) < THICKNESS
    return on


def _plane(points: Float[Array, "n 3"]) -> _Plane:
    """Normal and its information: the spread within the plane against the distances from it."""
    away = points - points.mean(0)
    values, axes = np.linalg.eigh(away.T @ away)
    sigma2 = max(values[0] / len(points), 1e-6)
    # Neighbouring points share errors: a tenth of them count.
    variance = 10.0 * sigma2 / values[1:] + BENT**2
    return _Plane(axes[:, 0], axes[:, 1:] @ np.diag(1.0 / variance) @ axes[:, 1:].T)
