"""The ground as a height map, learned from the places where feet stand.

A Gaussian process over the plane: one part varies over metres (floors, slopes), another over the
length of a foot (treads, kerbs). It is asked only near the places it was learned from. Where the
floor's height is known, each foothold is on it, or on something else of any height.

Source: Rasmussen & Williams 2006, "Gaussian Processes for Machine Learning", section 2.2; robust
weights: Student's t by expectation maximisation, Lange, Little & Taylor 1989.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.series import runs

WIDE_M, WIDE_SIGMA = 4.0, 0.3
"""Correlation length and standard deviation, m, of floors and slopes."""
NARROW_M, NARROW_SIGMA = 0.15, 0.1
"""The same of treads and kerbs."""
KNOWN_M = 0.3
"""Horizontal distance from a foothold within which the ground is known."""
NOISE_M = 0.01
"""Standard deviation of a foothold's height."""
ON_FLOOR = 0.95
"""Probability that a foothold is on a known floor, before its height is looked at."""
UNEVEN_M = 0.02
"""Standard deviation of a floor's height from place to place: carpets, soles."""
_RANGE_M = 2.0  # of the heights of other footholds
_FREEDOM = 4.0  # degrees of freedom of the footholds' errors
_ROUNDS = 5


@dataclass(frozen=True, eq=False)
class Footholds:
    """Places where a heel or toe stood."""

    places: Float[Array, "N 3"]  # world, m; z of the ground
    weights: Float[Array, "N"]  # 0 to 1
    spread: Float[Array, "N"]  # standard deviation of the height, without contacts, m

    def on_floor(self, floor_std: float) -> Footholds:
        """With those moved to height 0 that are more probably on a floor there than elsewhere."""
        std = np.sqrt(self.spread**2 + floor_std**2 + UNEVEN_M**2)
        likely = np.exp(-0.5 * np.square(self.places[:, 2] / std)) / (np.sqrt(2.0 * np.pi) * std)
        places = self.places.copy()
        places[ON_FLOOR * likely > (1.0 - ON_FLOOR) / _RANGE_M, 2] = 0.0
        return Footholds(places, self.weights, self.spread)


@dataclass(frozen=True, eq=False)
class Ground:
    """The height of the ground around footholds."""

    footholds: Footholds
    level: float  # m, the footholds' weighted median height
    gains: Float[Array, "N"]  # solved weights of the process

    @classmethod
    def learn(cls, footholds: Footholds) -> Ground:
        """The height map of some footholds, robust to wrong ones."""
        places, weights = footholds.places, np.maximum(footholds.weights, 1e-3)
        if not len(places):
            return cls(footholds, 0.0, np.zeros(0))
        level = _weighted_median(places[:, 2], weights)
        K, away = _covariance(places[:, :2], places[:, :2]), places[:, 2] - level
        trust = np.ones(len(places))
        for _ in range(_ROUNDS):
            noise = NOISE_M**2 / (weights * trust)
            gains = np.linalg.solve(K + np.diag(noise), away)
            residual = np.square(away - K @ gains) / NOISE_M**2
            trust = (_FREEDOM + 1.0) / (_FREEDOM + residual)
        return cls(footholds, level, gains)

    def height(self, xy: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
        """Height of the ground, m; the level where nothing is near."""
        if not len(self.gains):
            return np.full(xy.shape[:-1], self.level)
        flat = xy.reshape(-1, 2)
        K = _covariance(flat, self.footholds.places[:, :2])
        return self.level + (K @ self.gains).reshape(xy.shape[:-1])

    def known(self, xy: Float[Array, "*batch 2"]) -> Bool[Array, "*batch"]:
        """Whether a foothold is near."""
        from scipy.spatial import KDTree

        if not len(self.gains):
            return np.zeros(xy.shape[:-1], bool)
        distance, _ = KDTree(self.footholds.places[:, :2]).query(xy)
        return np.asarray(distance <= KNOWN_M)


def footholds(
    points: Float[Array, "T P 3"], contact: Float[Array, "T P"], spread: Float[Array, "T P"],
    sole_m: float,
) -> Footholds:  # fmt: skip
    """One foothold for every stretch of frames in which a point touches (0.5 or more)."""
    found = []
    for k in range(points.shape[1]):
        touching = np.flatnonzero(contact[:, k] >= 0.5)
        for run in runs(touching):
            share = contact[run, k]
            place = np.average(points[run, k], axis=0, weights=share)
            weight = min(1.0, float(share.sum()) / 5.0)
            found.append([*place, weight, np.average(spread[run, k], weights=share)])
    table = np.array(found).reshape(-1, 5)
    return Footholds(table[:, :3] - [0.0, 0.0, sole_m], table[:, 3], table[:, 4])


def _covariance(a: Float[Array, "N 2"], b: Float[Array, "M 2"]) -> Float[Array, "N M"]:
    squared = np.square(a[:, None] - b[None]).sum(-1)
    wide = WIDE_SIGMA**2 * np.exp(-0.5 * squared / WIDE_M**2)
    return wide + NARROW_SIGMA**2 * np.exp(-0.5 * squared / NARROW_M**2)


def _weighted_median(values: Float[Array, "N"], weights: Float[Array, "N"]) -> float:
    order = np.argsort(values)
    share = np.cumsum(weights[order]) / weights.sum()
    return float(values[order][np.searchsorted(share, 0.5)])
