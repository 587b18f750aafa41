"""Do the views agree with the rig file? How far the rays of confident detections miss each other.

Two rays of one joint meet where the joint is, within the detector's error, if the rig describes the
cameras and the views are not exchanged. Where they do not meet, the rotation of the views against
each other that makes them meet is estimated.

Source: Hartley & Sturm 1997, "Triangulation", the midpoint method; epipolar constraint: Hartley &
Zisserman 2004, chapter 9.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.geometry import exponential, unit

CONFIDENT = 0.6
"""Visibility probability of detections that are compared."""
ENOUGH = 50
"""Pairs of detections without which nothing is said."""
_REACH_M = (0.1, 2.5)  # from a camera to a joint of its wearer
_PARALLAX = np.deg2rad(8.0)  # between two rays, from which their midpoint gives a distance
_LEAST_TURN, _MOST_TURN = np.deg2rad((1.0, 60.0))
_LEAST_SIGMA = np.deg2rad(0.05)
_MOST_PAIRS = 1500


@dataclass(frozen=True)
class Agreement:
    """Median angle by which rays miss each other, degrees; nan where too few were compared."""

    pairs: int
    as_given: float
    exchanged: float  # with those two views exchanged with which it is smallest
    expected: float  # of the detector's standard deviation alone
    turned: float = float("nan")  # rotation of two views that explains it, where one does

    @property
    def looks_exchanged(self) -> bool:
        """Whether the views fit the rig only in the other order."""
        return self.exchanged < min(0.5 * self.as_given, self._most)

    @property
    def looks_like_another_rig(self) -> bool:
        """Whether the views fit the rig in no order."""
        return self.as_given > self._most and not self.looks_exchanged

    @property
    def _most(self) -> float:
        """Of views that fit the rig."""
        return max(3.0 * self.expected, 0.8)


def check_agreement(found: Detections, rig: Rig, frames: int = 300) -> Agreement:
    """Compare the views in frames spread over a recording. A rig of one camera gives nan."""
    found = spread(found, frames)
    points, sure = found.points, _sure(found)
    pairs = _pairs(points, sure, rig)
    given = _misses(pairs)
    if len(given) < ENOUGH:
        return Agreement(len(given), np.nan, np.nan, np.nan)
    exchanged = np.inf
    for order in _exchanges(len(rig.mounts)):
        scale = _sizes(rig) / _sizes(rig)[order]
        other = _misses(_pairs(points[:, order] * scale[:, None], sure[:, order], rig))
        if len(other) >= ENOUGH:
            exchanged = min(exchanged, float(np.median(other)))
    sigma = float(np.median(found.sigma[sure]) * _radians_per_pixel(rig))
    turns = [turn for pair in pairs if (turn := _turn(pair, sigma)) is not None]
    return Agreement(
        len(given), float(np.rad2deg(np.median(given))),
        float(np.rad2deg(exchanged)) if np.isfinite(exchanged) else np.nan,
        float(np.rad2deg(sigma)), float(np.rad2deg(max(turns))) if turns else np.nan,
    )  # fmt: skip


def triangulate(found: Detections, rig: Rig) -> tuple[Float[Array, "T 18 3"], Bool[Array, "T 18"]]:
    """Joints [m, head frame] where two views' rays come closest, and where there is one.

    Only confident detections whose rays meet at a sufficient angle, in front of both cameras.
    """
    joints, known = np.zeros((*found.valid.shape[::2], 3)), np.zeros(found.valid.shape[::2], bool)
    for pair in _pairs(found.points, _sure(found), rig):
        met = np.zeros(pair.both.shape, bool)
        middle, inside = _meet(pair)
        met[pair.both] = inside & (_angle(pair.u, pair.v) > _PARALLAX)
        met &= ~known
        joints[met] = middle[met[pair.both]]
        known |= met
    return joints, known


def spread(found: Detections, frames: int) -> Detections:
    """At most so many frames of the detections, spread over them evenly."""
    return found[:: max(-(-len(found.times) // frames), 1)]


@dataclass(frozen=True, eq=False)
class _Pair:
    """Confident detections of the same joints in two views."""

    first: Float[Array, "3"]  # cameras, head frame
    second: Float[Array, "3"]
    u: Float[Array, "n 3"]  # rays, unit
    v: Float[Array, "n 3"]
    both: Bool[Array, "T 18"]  # the n joints


def _pairs(points: Float[Array, "T V 18 2"], sure: Array, rig: Rig) -> list[_Pair]:
    pixels = np.moveaxis(np.where(sure[..., None], points, 0.0), 1, 0)
    centres, rays, inside = rig.rays(pixels)
    pairs = []
    for a, b in combinations(range(len(centres)), 2):
        both = sure[:, a] & sure[:, b] & inside[a] & inside[b]
        pairs.append(_Pair(centres[a], centres[b], rays[a][both], rays[b][both], both))
    return pairs


def _misses(pairs: list[_Pair]) -> Float[Array, "n"]:
    """Angles [rad] between rays and the midpoint where they come closest, of all pairs of views."""
    found = []
    for pair in pairs:
        middle, _ = _meet(pair)
        found.append(0.5 * (_angle(middle - pair.first, pair.u)
                            + _angle(middle - pair.second, pair.v)))  # fmt: skip
    return np.concatenate(found) if found else np.zeros(0)


def _meet(pair: _Pair) -> tuple[Float[Array, "n 3"], Bool[Array, "n"]]:
    """The midpoint where two rays come closest within reach, and whether that is within reach."""
    base, cosine = pair.second - pair.first, np.sum(pair.u * pair.v, -1)
    along_u, along_v = pair.u @ base, pair.v @ base
    size = np.maximum(1.0 - cosine**2, 1e-9)
    s, t = (along_u - cosine * along_v) / size, (cosine * along_u - along_v) / size
    low, high = _REACH_M
    inside = (s > low) & (s < high) & (t > low) & (t < high)
    s, t = np.clip(s, low, high)[:, None], np.clip(t, low, high)[:, None]
    return 0.5 * (pair.first + s * pair.u + pair.second + t * pair.v), inside


def _turn(pair: _Pair, sigma: float) -> float | None:
    """Rotation [rad] between two views, or of both in place, that makes their rays meet.

    Of the second view's rays, and of the line between the cameras: what the epipolar constraint
    determines. None where the misses are as small as the detector states (`sigma`, radians), or no
    rotation below 60 degrees explains them.
    """
    from scipy.optimize import least_squares

    base = pair.second - pair.first
    if len(pair.u) < ENOUGH or np.linalg.norm(base) < 1e-3:
        return None
    sigma = max(sigma, _LEAST_SIGMA)  # exact detections state none
    step = -(-len(pair.u) // _MOST_PAIRS)
    u, v, base = pair.u[::step], pair.v[::step], unit(base)

    def off(x: Float[Array, "6"]) -> Float[Array, "n"]:
        turned, line = v @ exponential(x[:3]).T, exponential(x[3:]) @ base
        return np.arcsin(np.clip(np.sum(unit(np.cross(line, u)) * turned, -1), -1.0, 1.0))

    before = float(np.median(np.abs(off(np.zeros(6)))))
    if before < 1.5 * sigma:  # the median of errors as large as stated is 0.95 sigma
        return None
    weak = 0.1  # holds what the rays do not determine
    x = np.zeros(6)
    for scale in (np.deg2rad(10.0), 2.0 * sigma):  # a wide basin first
        x = least_squares(lambda x, scale: np.append(off(x) / scale, weak * x), x, loss="cauchy",
                          args=(scale,)).x  # fmt: skip
    angle = max(np.linalg.norm(x[:3]), np.linalg.norm(x[3:]))
    after = float(np.median(np.abs(off(x))))
    if after > min(0.7 * before, 2.5 * sigma) or not _LEAST_TURN < angle < _MOST_TURN:
        return None
    return float(angle)


def _angle(direction: Float[Array, "n 3"], ray: Float[Array, "n 3"]) -> Float[Array, "n"]:
    cross = np.linalg.norm(np.cross(direction, ray), axis=-1)
    return np.arctan2(cross, np.sum(direction * ray, -1))


def _exchanges(views: int) -> list[list[int]]:
    """All orders of the views in which two are exchanged."""
    orders = []
    for a, b in combinations(range(views), 2):
        order = list(range(views))
        order[a], order[b] = b, a
        orders.append(order)
    return orders


def _sure(found: Detections) -> Bool[Array, "T V 18"]:
    return found.valid & (found.confidence > CONFIDENT)


def _sizes(rig: Rig) -> Float[Array, "V 2"]:
    return np.array([(camera.width, camera.height) for camera in rig.cameras], float)


def _radians_per_pixel(rig: Rig) -> float:
    camera = rig.cameras[0]
    return 2.0 * camera.max_angle / camera.width
