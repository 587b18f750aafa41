"""Bundle adjustment over rays: keyframes and points of a map, Levenberg-Marquardt.

In: poses, points and observations. Out: the refined poses and points, and the reduced system, from
which the covariance of the keyframes follows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy.sparse import bsr_array, csc_array
from scipy.sparse.linalg import splu

from egocap.odometry import adjustment_kernel as kernel
from egocap.odometry.ray_kernel import turned

_DENSE = 60  # keyframes up to which the reduced system is solved as a dense matrix
_LARGEST_DAMPING = 1e6


@dataclass(frozen=True, eq=False)
class Problem:
    """Observations of points by keyframes, grouped by point."""

    R: Float[Array, "K 3 3"]  # R_world_head
    t: Float[Array, "K 3"]  # metres
    points: Float[Array, "P 3"]  # metres, world
    start: Int[Array, "P+1"]  # the observations of point p are start[p] .. start[p + 1]
    frame: Int[Array, "N"]  # keyframe of an observation
    origin: Float[Array, "N 3"]  # centre of its camera in the head frame
    ray: Float[Array, "N 3"]  # unit vector in the head frame
    inv_sigma: Float[Array, "N"]  # 1 / rad
    fixed: Bool[Array, "K"]


@dataclass(frozen=True, eq=False)
class Adjusted:
    """The result of a bundle adjustment."""

    R: Float[Array, "K 3 3"]
    t: Float[Array, "K 3"]
    points: Float[Array, "P 3"]
    cost: float
    rounds: int
    row: Int[Array, "K"]  # of a keyframe in `system`; -1: fixed
    system: csc_array | None  # 6F x 6F, rotation and translation of each free keyframe


def adjust(problem: Problem, width: float, rounds: int, *, system: bool = False) -> Adjusted:
    """Minimise the Geman-McClure loss of `width` standard deviations.

    Stops after `rounds` accepted steps, or when a step gains less than one part in 10,000.
    `system`: also return the reduced normal matrix at the solution.
    """
    p = problem
    R, t, X = p.R.copy(), p.t.copy(), p.points.copy()
    row = np.full(len(R), kernel.NONE)
    row[~p.fixed] = np.arange((~p.fixed).sum())
    free = int((~p.fixed).sum())
    slot = np.full((free, free), kernel.NONE, np.int32)
    count = kernel.pair_slots(p.start, p.frame, row, slot)
    seen = (p.start, p.frame, p.origin, p.ray, p.inv_sigma, width)
    cost, damping, done = kernel.robust_cost(R, t, X, *seen), 1e-4, 0
    for _ in range(rounds):
        blocks, g = np.zeros((count, 6, 6)), np.zeros((free, 6))
        parts = kernel.reduced_system(R, t, X, *seen, row, slot, blocks, g, damping)
        step = _solve(blocks, slot, g, damping)
        moved = kernel.back_substitute(X, p.start, p.frame, row, *parts, step)
        R_new, t_new = _stepped(R, t, row, step)
        new = kernel.robust_cost(R_new, t_new, moved, *seen)
        if not new < cost:
            damping *= 10.0
            if damping > _LARGEST_DAMPING:
                break
            continue
        gain, cost, damping = (cost - new) / cost, new, max(damping * 0.2, 1e-9)
        R, t, X, done = R_new, t_new, moved, done + 1
        if gain < 1e-4:
            break
    matrix = None
    if system and free:
        blocks, g = np.zeros((count, 6, 6)), np.zeros((free, 6))
        kernel.reduced_system(R, t, X, *seen, row, slot, blocks, g, 0.0)
        matrix = _matrix(blocks, slot)
    return Adjusted(R, t, X, cost, done, row, matrix)


def _solve(
    blocks: Float[Array, "B 6 6"], slot: Int[Array, "F F"], g: Float[Array, "F 6"], damping: float
) -> Float[Array, "F 6"]:
    if not len(g):
        return g
    matrix = _matrix(blocks, slot)
    diagonal = matrix.diagonal()
    matrix = matrix + csc_array(
        (diagonal * damping + 1e-9, (np.arange(g.size), np.arange(g.size))), shape=matrix.shape
    )
    if len(g) <= _DENSE:
        return np.linalg.solve(matrix.toarray(), -g.ravel()).reshape(-1, 6)
    solved = splu(csc_array(matrix), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    return solved.solve(-g.ravel()).reshape(-1, 6)


def _matrix(blocks: Float[Array, "B 6 6"], slot: Int[Array, "F F"]) -> csc_array:
    """The symmetric matrix of which `blocks` is the upper triangle."""
    i, j = np.nonzero(slot != kernel.NONE)
    upper = blocks[slot[i, j]]
    below = i != j
    rows, columns = np.concatenate([i, j[below]]), np.concatenate([j, i[below]])
    data = np.concatenate([upper, upper[below].transpose(0, 2, 1)])
    order = np.lexsort((columns, rows))
    count = len(slot)
    pointer = np.searchsorted(rows[order], np.arange(count + 1))
    matrix = bsr_array((data[order], columns[order], pointer), shape=(6 * count, 6 * count))
    return csc_array(matrix)


def _stepped(
    R: Float[Array, "K 3 3"],
    t: Float[Array, "K 3"],
    row: Int[Array, "K"],
    step: Float[Array, "F 6"],
) -> tuple[Float[Array, "K 3 3"], Float[Array, "K 3"]]:
    R, t = R.copy(), t.copy()
    for k in np.flatnonzero(row != kernel.NONE):
        R[k] = turned(R[k], step[row[k], :3])
        t[k] += step[row[k], 3:]
    return R, t
