"""Patches of the skin's surface, and Laplacian smoothing on them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from egocap_sim.human.body.anny_model import anatomy


@dataclass(frozen=True, eq=False)
class Patch:
    """The vertices of a part of the skin that have neighbours in it."""

    vertices: Int[Array, "P"]
    half_mean: sp.csr_array  # (P, P), maps values to half the mean of their neighbours

    def smoothed(self, values: Float[Array, "N D"], rounds: int) -> Float[Array, "N D"]:
        """Average the values of the patch's vertices with their neighbours' mean, `rounds` times.

        Values outside the patch are unchanged.
        """
        result = values.copy()
        moved = values[self.vertices]
        for _ in range(rounds):
            moved = self.half_mean @ moved + 0.5 * moved
        result[self.vertices] = moved
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
            moved = self.half_mean @ moved + 0.5 * moved
            x, y, z = ((moved - skin) * normals).T
            moved += normals * np.maximum(least - (x + y + z), 0.0)[:, None]
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
    neighbours = count[vertices]
    weights, start = np.repeat(0.5 / neighbours, neighbours), np.append(0, np.cumsum(neighbours))
    shape = (len(vertices), len(vertices))
    return Patch(vertices, sp.csr_array((weights, place[second[both]], start), shape))


@cache
def _edges() -> tuple[Int[Array, "E"], Int[Array, "E"]]:
    """Pairs of each vertex with each of its neighbours, in order of the vertex."""
    faces = anatomy().faces
    n = len(anatomy().owner)
    a, b = faces.ravel(), np.roll(faces, -1, 1).ravel()
    graph = sp.coo_array((np.ones(2 * len(a), bool), (np.r_[a, b], np.r_[b, a])), (n, n)).tocsr()
    return np.repeat(np.arange(n), np.diff(graph.indptr)), graph.indices
