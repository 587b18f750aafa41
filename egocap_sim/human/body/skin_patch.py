"""Part of the skin's surface, and averages between neighbours on it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numba
import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from egocap_sim.human.body.anny_model import anatomy


@dataclass(frozen=True, eq=False)
class Patch:
    """The skin's vertices that have a neighbour in a part of it, and those neighbours.

    Those of vertices[i] are vertices[beside[start[i] : start[i + 1]]].
    """

    vertices: Int[Array, "P"]
    start: Int[Array, "P+1"]
    beside: Int[Array, "E"]

    def smoothed(self, values: Float[Array, "N D"], rounds: int) -> Float[Array, "N D"]:
        """Values of every skin vertex, half of each replaced by its neighbours' mean, repeatedly.

        Outside the patch they stay as they are.
        """
        result = values.copy()
        result[self.vertices] = _smoothed(values[self.vertices], self.start, self.beside, rounds)
        return result

    def smoothed_over(
        self,
        points: Float[Array, "N 3"],
        skin: Float[Array, "N 3"],
        normals: Float[Array, "N 3"],
        least: Float[Array, "N"],
        rounds: int,
    ) -> Float[Array, "N 3"]:
        """Points `smoothed`, and put back at the least distance (m) from the skin every time."""
        moved, skin, normals, least = (a[self.vertices] for a in (points, skin, normals, least))
        for _ in range(rounds):
            moved = _smoothed(moved, self.start, self.beside, 1)
            _lift(moved, skin, normals, least)
        result = points.copy()
        result[self.vertices] = moved
        return result


def make_patch(inside: Bool[Array, "N"]) -> Patch:
    """The patch of the vertices inside."""
    first, second = _edges()
    both = inside[first] & inside[second]
    count = np.bincount(first[both], minlength=len(inside))
    vertices = np.flatnonzero(count)
    place = np.cumsum(count > 0) - 1
    return Patch(vertices, np.append(0, np.cumsum(count[vertices])), place[second[both]])


@cache
def _edges() -> tuple[Int[Array, "E"], Int[Array, "E"]]:
    """Every vertex with each of its neighbours, in order."""
    faces = anatomy().faces
    n = len(anatomy().owner)
    a, b = faces.ravel(), np.roll(faces, -1, 1).ravel()
    graph = sp.coo_array((np.ones(2 * len(a), bool), (np.r_[a, b], np.r_[b, a])), (n, n)).tocsr()
    return np.repeat(np.arange(n), np.diff(graph.indptr)), graph.indices


@numba.njit(cache=True)
def _smoothed(
    values: Float[Array, "P D"], start: Int[Array, "P+1"], beside: Int[Array, "E"], rounds: int
) -> Float[Array, "P D"]:
    before, after = values.copy(), np.empty_like(values)
    count, depth = values.shape
    for _ in range(rounds):
        for i in range(count):
            share = 0.5 / (start[i + 1] - start[i])
            for d in range(depth):
                after[i, d] = 0.0
            for k in range(start[i], start[i + 1]):
                j = beside[k]
                for d in range(depth):
                    after[i, d] += share * before[j, d]
            for d in range(depth):
                after[i, d] += 0.5 * before[i, d]
        before, after = after, before
    return before


@numba.njit(cache=True)
def _lift(
    points: Float[Array, "P 3"],
    skin: Float[Array, "P 3"],
    normals: Float[Array, "P 3"],
    least: Float[Array, "P"],
) -> None:
    """Move points that lie closer to the skin than the least distance (m) away from it."""
    for n in range(len(points)):
        distance = 0.0
        for axis in range(3):
            distance += (points[n, axis] - skin[n, axis]) * normals[n, axis]
        for axis in range(3):
            points[n, axis] += normals[n, axis] * max(least[n] - distance, 0.0)
