"""Garment shells: the skin offset outward, smoothed, cut along hems, with hems folded inward."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from egocap.geometry import unit
from egocap_sim.core.bodies import BODIES
from egocap_sim.human.body.anny_model import anatomy
from egocap_sim.human.body.body_chart import TORSO, BodyChart
from egocap_sim.human.body.skin_patch import make_patch
from egocap_sim.human.body.triangles import distinct, edge_counts

APRON = 0.06  # m of cloth beyond the hems while smoothing, to avoid boundary effects
ELSEWHERE = 1.0  # m, depth inside an edge of vertices that the edge does not concern
TIGHT, WIDE = 2, 24  # rounds of averaging of the skin weights
HEM_FOLD = 0.7  # share of the gap to the skin by which a hem is folded inward


@dataclass(frozen=True, eq=False)
class Level:
    """An edge at one height (m) of the draped cloth; cloth lies above it or below it."""

    height: float
    above: bool
    where: Bool[Array, "N"]  # vertices it concerns

    def inside(self, points: Float[Array, "N 3"]) -> Float[Array, "N"]:
        """Distance inside the edge of vertices at these points."""
        depth = points[:, 2] - self.height
        return np.where(self.where, depth if self.above else -depth, ELSEWHERE)


@dataclass(frozen=True, eq=False)
class Pattern:
    """Extent of a garment, and its distance from the skin.

    `edges` are distances (m) inside each edge; cloth lies where all are positive, and on its side
    of `level`. Skin more than `margin` (m) inside every edge is hidden. `gap` (m) is the least
    distance to the skin along its normal; `looseness` (m) is added before `rounds` of averaging
    smooth the cloth and bridge hollows. `span` (0 to 1) blends in widely averaged skin weights, as
    between the legs. `fall` moves the smoothed cloth before it is cut.
    """

    edges: Sequence[Float[Array, "N"]]
    gap: Float[Array, "N"]
    looseness: Float[Array, "N"] | float = 0.0
    level: Level | None = None
    margin: float = 0.05
    span: Float[Array, "N"] | None = None
    rounds: int = 14
    fall: Callable[[Float[Array, "N 3"]], Float[Array, "N 3"]] | None = None

    def edges_at(self, points: Float[Array, "N 3"]) -> list[Float[Array, "N"]]:
        """Distances inside each edge of vertices at these points."""
        return [*self.edges, *([self.level.inside(points)] if self.level else [])]


@dataclass(frozen=True, eq=False)
class Shell:
    """Cloth at rest, without a texture."""

    vertices: Float[Array, "M 3"]
    skin: Float[Array, "M 3"]  # the point of the skin under each vertex
    faces: Int[Array, "F 3"]
    weights: Float[Array, "M 21"]
    piece: Int[Array, "M"]  # of `body_chart`
    light: Float[Array, "M"]  # openness (0 to 1): low in armpits and between the legs
    covered: Bool[Array, "N"]  # hidden vertices of the bare skin


def make_shell(chart: BodyChart, pattern: Pattern, buried: Bool[Array, "N"] | None = None) -> Shell:
    """Cut a garment from the body.

    Triangles all of whose corners are `buried` (under another garment) are left out.
    """
    depth, skin = np.min(pattern.edges_at(chart.vertices), axis=0), chart.vertices
    near, covered = depth > -APRON, depth > pattern.margin
    # Far from its edges, where no skin is drawn, cloth on the torso may come closer to the skin.
    closer = np.maximum(pattern.gap - 0.006, 0.0015)
    least = np.where(covered & (chart.piece == TORSO), closer, pattern.gap)
    patch = make_patch(near)
    outward = unit(patch.smoothed(chart.normals, 4))
    cloth = skin + outward * (pattern.gap + pattern.looseness)[:, None]
    cloth = patch.smoothed_over(cloth, skin, chart.normals, least, pattern.rounds)
    if pattern.fall is not None:
        cloth = pattern.fall(cloth)
    weights = patch.smoothed(skin_weights(), TIGHT)
    if pattern.span is not None:
        wide = patch.smoothed(weights, WIDE - TIGHT)
        weights = weights + pattern.span[:, None] * (wide - weights)
    faces = anatomy().faces
    faces = faces[near.take(faces.T).all(0)]
    if buried is not None:
        faces = faces[~buried.take(faces.T).all(0)]
    light = patch.smoothed(anatomy().openness.astype(float)[:, None], 4)[:, 0]
    mix = sp.csr_matrix(sp.identity(len(near)))
    for edge in pattern.edges_at(cloth):
        faces, step = clip(faces, mix @ edge)
        mix = sp.csr_matrix(step @ mix)
    piece = chart.piece[mix.indices[mix.indptr[:-1]]]
    return _turn_hems(
        Shell(mix @ cloth, mix @ skin, faces, mix @ weights, piece, mix @ light, covered)
    )


@cache
def skin_weights() -> Float[Array, "N 21"]:
    """Weights of the skin's vertices on all bodies."""
    shape = anatomy()
    weights = np.zeros((len(shape.bones), len(BODIES)))
    np.put_along_axis(weights, shape.bones, shape.weights, 1)
    return weights


def clip(
    faces: Int[Array, "F 3"], value: Float[Array, "N"]
) -> tuple[Int[Array, "G 3"], sp.csr_matrix]:
    """Cut triangles along the line where `value` is zero and keep the side above it.

    Returns the new triangles and the matrix (M, N) that maps attributes of the old vertices to
    the new ones.
    """
    inside = value > 0
    count = inside.take(faces.T).sum(0)
    # Rotate the cut triangles so that the single corner on one side comes first.
    lone = _alone_first(faces[count == 1], inside)
    pair = _alone_first(faces[count == 2], ~inside)
    crossed = np.concatenate([lone[:, [0, 1]], lone[:, [0, 2]], pair[:, [0, 1]], pair[:, [0, 2]]])
    n, crossed = len(value), crossed.astype(np.int64)
    key, index = np.unique(crossed.min(1) * n + crossed.max(1), return_inverse=True)
    low, high, index = key // n, key % n, index + n
    a, b, c, d = np.split(index, np.cumsum([len(lone), len(lone), len(pair)]))
    cut = np.concatenate([
        faces[count == 3],
        np.stack([lone[:, 0], a, b], 1),
        np.stack([c, pair[:, 1], pair[:, 2]], 1),
        np.stack([c, pair[:, 2], d], 1),
    ])  # fmt: skip
    share, new = value[low] / (value[low] - value[high]), n + np.arange(len(key))
    rows = np.concatenate([np.arange(n), new, new])
    columns = np.concatenate([np.arange(n), low, high])
    amount = np.concatenate([np.ones(n), 1 - share, share])
    mix = sp.csr_matrix((amount, (rows, columns)), shape=(n + len(key), n))
    first, index = distinct(cut.ravel())
    return index.reshape(-1, 3), mix[cut.ravel()[first]]


def border(faces: Int[Array, "F 3"]) -> Int[Array, "E 2"]:
    """Directed edges that have a triangle on one side only."""
    edges, count = edge_counts(faces)
    return edges[count == 1]


def _alone_first(faces: Int[Array, "F 3"], mask: Bool[Array, "N"]) -> Int[Array, "F 3"]:
    start = mask[faces].argmax(1)
    return np.take_along_axis(faces, (start[:, None] + np.arange(3)) % 3, 1)


def _turn_hems(shell: Shell) -> Shell:
    """Add a narrow strip inside every edge, so that cloth shows a thickness there."""
    edges, count = border(shell.faces), len(shell.vertices)
    rim = np.unique(edges)
    place = np.zeros(count, int)
    place[rim] = count + np.arange(len(rim))
    a, b = edges.T
    strip = np.concatenate([np.stack([b, a, place[a]], 1), np.stack([b, place[a], place[b]], 1)])
    turned = shell.vertices[rim] * (1 - HEM_FOLD) + shell.skin[rim] * HEM_FOLD
    twice = np.append(np.arange(count), rim)
    return replace(
        shell,
        vertices=np.concatenate([shell.vertices, turned]),
        skin=shell.skin[twice],
        faces=np.concatenate([shell.faces, strip]),
        weights=shell.weights[twice],
        piece=shell.piece[twice],
        light=np.concatenate([shell.light, 0.6 * shell.light[rim]]),
    )
