"""Do the views agree with the rig file? How far the rays of confident detections miss each other.

Two rays of one joint meet where the joint is, within the detector's error, if the rig describes the
cameras and the views are not exchanged.

Source: Hartley & Sturm 1997, "Triangulation", the midpoint method.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.cameras.rig import Rig
from egocap.data.detections import Detections

CONFIDENT = 0.6
"""Visibility probability of detections that are compared."""
ENOUGH = 50
"""Pairs of detections without which nothing is said."""
_REACH_M = (0.1, 2.5)  # from a camera to a joint of its wearer


@dataclass(frozen=True)
class Agreement:
    """Median angle by which rays miss each other, degrees; nan where too few were compared."""

    pairs: int
    as_given: float
    exchanged: float  # with the first two views exchanged
    expected: float  # of the detector's standard deviation alone

    @property
    def looks_exchanged(self) -> bool:
        """Whether the views fit the rig only in the other order."""
        return self.exchanged < 0.5 * self.as_given and self.as_given > 2.0 * self.expected

    @property
    def looks_like_another_rig(self) -> bool:
        """Whether the views fit the rig in no order."""
        return self.as_given > max(3.0 * self.expected, 0.8) and not self.looks_exchanged


def check_agreement(found: Detections, rig: Rig, frames: int = 300) -> Agreement:
    """Compare the views in frames spread over a recording. A rig of one camera gives nan."""
    rows = np.unique(np.linspace(0, len(found.times) - 1, frames).round().astype(int))
    points, sure = found.points[rows], found.valid[rows] & (found.confidence[rows] > CONFIDENT)
    given, pairs = _misses(points, sure, rig)
    if pairs < ENOUGH:
        return Agreement(pairs, np.nan, np.nan, np.nan)
    order = [1, 0, *range(2, len(rig.mounts))]
    scale = _sizes(rig) / _sizes(rig)[order]
    exchanged, other = _misses(points[:, order] * scale[:, None], sure[:, order], rig)
    sigma = np.median(found.sigma[rows][sure]) * _radians_per_pixel(rig)
    return Agreement(
        pairs, float(np.rad2deg(np.median(given))),
        float(np.rad2deg(np.median(exchanged))) if other >= ENOUGH else np.nan,
        float(np.rad2deg(sigma)),
    )  # fmt: skip


def _misses(
    points: Float[Array, "F V 18 2"], sure: Array, rig: Rig
) -> tuple[Float[Array, "n"], int]:
    """Angles [rad] between rays and the midpoint where they come closest, of all pairs of views."""
    pixels = np.moveaxis(np.where(sure[..., None], points, 0.0), 1, 0)
    centres, rays, inside = rig.rays(pixels)
    found = []
    for a, b in combinations(range(len(centres)), 2):
        both = sure[:, a] & sure[:, b] & inside[a] & inside[b]
        found.append(_miss(centres[a], centres[b], rays[a][both], rays[b][both]))
    angles = np.concatenate(found) if found else np.zeros(0)
    return angles, len(angles)


def _miss(
    first: Float[Array, "3"], second: Float[Array, "3"], u: Float[Array, "n 3"],
    v: Float[Array, "n 3"],
) -> Float[Array, "n"]:  # fmt: skip
    base, cosine = second - first, np.sum(u * v, -1)
    along_u, along_v = u @ base, v @ base
    size = np.maximum(1.0 - cosine**2, 1e-9)
    s = np.clip((along_u - cosine * along_v) / size, *_REACH_M)
    t = np.clip((cosine * along_u - along_v) / size, *_REACH_M)
    middle = 0.5 * (first + s[:, None] * u + second + t[:, None] * v)
    return 0.5 * (_angle(middle - first, u) + _angle(middle - second, v))


def _angle(direction: Float[Array, "n 3"], ray: Float[Array, "n 3"]) -> Float[Array, "n"]:
    cross = np.linalg.norm(np.cross(direction, ray), axis=-1)
    return np.arctan2(cross, np.sum(direction * ray, -1))


def _sizes(rig: Rig) -> Float[Array, "V 2"]:
    return np.array([(camera.width, camera.height) for camera in rig.cameras], float)


def _radians_per_pixel(rig: Rig) -> float:
    camera = rig.cameras[0]
    return 2.0 * camera.max_angle / camera.width
