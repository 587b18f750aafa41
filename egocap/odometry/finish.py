"""The poses of a whole recording: all keyframes adjusted together, then every frame against them.

In: the map of an odometry. Out: poses of its longest segment with covariances, and its points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from egocap.geometry import rigid
from egocap.odometry.adjustment import Adjusted, Problem, adjust
from egocap.odometry.ray_kernel import refine_pose, squared_residuals
from egocap.odometry.track_map import TrackMap
from egocap.odometry.views import Views
from egocap.series import interpolate

LOSS = 3.0  # standard deviations
_SAMPLED = 150  # keyframes whose covariance is computed; between them it is interpolated


@dataclass(frozen=True, eq=False)
class Finished:
    """Poses of the frames of one segment, in its own map's frame."""

    frame: Int[Array, "N"]  # numbers of the sequence
    time: Float[Array, "N"]
    T_map_head: Float[Array, "N 4 4"]
    covariance: Float[Array, "N 6 6"]  # of rotation (head frame) and position; the first is exact
    points: Float[Array, "P 3"]
    noise: float  # residuals' standard deviation as a multiple of the assumed one
    keyframes: int
    segments: int


def finish(found: TrackMap, views: Views) -> Finished:
    """Adjust the segment with the most frames; the others are left out."""
    segment, keys = found.longest()
    found.renew_twists(range(len(found.frames)))
    problem, numbers = found.problem(keys, np.arange(len(keys)) < 1, views)
    result = adjust(problem, LOSS, 10, system=True)
    found.points[numbers] = result.points
    for i, k in enumerate(keys):
        found.frames[k].R, found.frames[k].t = result.R[i], result.t[i]
    noise = noise_factor(problem, result)
    own = _refine_frames(found, segment, set(keys), numbers, views)
    rows = [i for i, f in enumerate(found.frames) if f.segment == segment]
    frames = [found.frames[i] for i in rows]
    between = _interpolated(_covariances(result), np.array(keys), np.array(rows))
    poses = rigid(np.stack([f.R for f in frames]), np.stack([f.t for f in frames]))
    return Finished(
        np.array([f.index for f in frames]), np.array([f.time for f in frames]), poses,
        noise**2 * (between + own), result.points, noise, len(keys),
        len({f.segment for f in found.frames}),
    )  # fmt: skip


def noise_factor(problem: Problem, result: Adjusted) -> float:
    """Standard deviation of the inliers' residuals, in those assumed; robust (median)."""
    point = np.repeat(np.arange(len(result.points)), np.diff(problem.start))
    squared = np.empty(len(problem.frame))
    for k in range(len(result.R)):
        rows = np.flatnonzero(problem.frame == k)
        squared[rows] = squared_residuals(
            result.R[k], result.t[k], result.points[point[rows]], problem.origin[rows],
            problem.ray[rows], problem.inv_sigma[rows],
        )  # fmt: skip
    # Median of chi-square with 2 degrees of freedom; a share of them went into the points.
    free = 1.0 - 3.0 * len(result.points) / (2.0 * len(squared))
    return float(np.sqrt(np.median(squared) / (2.0 * np.log(2.0)) / max(free, 0.2)))


def _refine_frames(
    found: TrackMap, segment: int, keys: set[int], numbers: Int[Array, "P"],
    views: Views,
) -> Float[Array, "N 6 6"]:  # fmt: skip
    """Refine the frames between the keyframes against the points; their own covariances."""
    known = np.zeros(len(found.points), bool)
    known[numbers] = True
    own = []
    for i, f in enumerate(found.frames):
        if f.segment != segment:
            continue
        if i in keys:
            own.append(np.zeros((6, 6)))
            continue
        rows = np.flatnonzero(known[f.seen.point])
        seen = f.seen[rows]
        f.R, f.t, H = refine_pose(
            f.R, f.t, found.points[seen.point],
            *views.sights(seen.view, seen.ray, seen.delay, f.motion.twist), seen.inv_sigma,
            np.array([10.0, LOSS]), 5,
        )  # fmt: skip
        own.append(np.linalg.inv(H))
    return np.stack(own)


def _covariances(result: Adjusted) -> Float[Array, "K 6 6"]:
    """Covariance of every keyframe given the fixed ones, interpolated between a sample."""
    count = len(result.row)
    found = np.zeros((count, 6, 6))
    free = np.flatnonzero(result.row >= 0)
    if result.system is None or not len(free):
        return found
    system = csc_array(result.system)
    factor = splu(system, permc_spec="MMD_AT_PLUS_A")
    sample = free[np.unique(np.linspace(0, len(free) - 1, _SAMPLED).astype(int))]
    for k in sample:
        at = 6 * result.row[k]
        unit = np.zeros((len(system.indptr) - 1, 6))
        unit[at : at + 6] = np.eye(6)
        found[k] = factor.solve(unit)[at : at + 6]
    anchors = np.union1d(sample, np.flatnonzero(result.row < 0))
    return _interpolated(found[anchors], anchors, np.arange(count))


def _interpolated(
    values: Float[Array, "n 6 6"], at: Int[Array, "n"], wanted: Int[Array, "m"]
) -> Float[Array, "m 6 6"]:
    found = interpolate(wanted, at, values)
    return 0.5 * (found + found.transpose(0, 2, 1))
