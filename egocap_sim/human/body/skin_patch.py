"""Patches of the skin's surface, and Laplacian smoothing on them."""

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
    """The vertices of a part of the skin that have neighbours in it, and these neighbours.

    The neighbours of vertices[i] are vertices[beside[start[i] : start[i + 1]]].
    """

    vertices: Int[Array, "P"]
    start: Int[Array, "P+1"]
    beside: Int[Array, "E"]

    def smoothed(self, values: Float[Array, "N D"], rounds: int) -> Float[Array, "N D"]:
        """Average the values of the patch's vertices with their neighbours' mean, `rounds` times.

        Values outside the patch are unchanged.
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
        """Like `smoothed`, but each round restores the least distance (m) from the skin."""
        moved, skin, normals, least = (a[self.vertices] for a in (points, skin, normals, least))
        for _ in range(rounds):
            moved = _smoothed(moved, self.start, self.beside, 1)
            _lift(moved, skin, normals, least)
        result = points.copy()
        result[self.vertices] = moved
        return result


def make_patch(inside: Bool[Array, "N"]) -> Patch:
    """The patch of the vertices marked by a mask."""
    first, second = _edges()
    both = inside[first] & inside[second]
    count = np.bincount(first[both], minlength=len(inside))
    vertices = np.flatnonzero(count)
    place = np.cumsum(count > 0) - 1
    return Patch(vertices, np.append(0, np.cumsum(count[vertices])), place[second[both]])


@cache
def _edges() -> tuple[Int[Array, "E"], Int[Array, "E"]]:
    """Pairs of each vertex with each of its neighbours, in order of the vertex."""
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
    """Move points outward to at least the least distance (m) from the skin, in place."""
    for n in range(len(points)):
        distance = 0.0
        for axis in range(3):
            distance += (points[n, axis] - skin[n, axis]) * normals[n, axis]
        for axis in range(3):
            points[n, axis] += normals[n, axis] * max(least[n] - distance, 0.0)
