"""Depth of corners: plane sweep along the ray over inverse depths, then sub-pixel alignment.

Patches are warped as if they lay on a plane, so that any two fisheye views can be compared.
Source: plane sweep, Collins 1996; inverse depth, Civera et al. 2008.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array

from egocap.geometry import UP, unit
from egocap.odometry import patch_kernel as patches
from egocap.odometry.surface_patches import surface_slope
from egocap.odometry.views import Motion, Views

NEAREST, FARTHEST = 0.4, 40.0  # m
STEP = 2.0  # px of disparity between hypotheses
_ALIKE, _APART, _DISTINCT = 0.80, 3, 0.06
_LEAST_GAIN = 0.005  # of the correlation, for another orientation than facing the ray
_EPIPOLAR = 1.2  # px from the epipolar curve, or so many standard deviations:
_OFF_SIGMAS = 3.0


@dataclass(frozen=True, eq=False)
class StereoMatches:
    """Corners of one view found in another one; `rows` index the corners asked for."""

    rows: Array  # (m,)
    pixels: Float[Array, "m 2"]  # in the other view
    points_head: Float[Array, "m 3"]  # metres
    normal_head: Float[Array, "m 3"]  # of the plane that matches best


def match(
    views: Views, a: int, b: int, images: tuple[UInt8[Array, "H W"], ...],
    pixels: Float[Array, "n 2"], noise_px: float, motion: Motion,
) -> StereoMatches:  # fmt: skip
    """Corners of view a that one place of view b matches distinctly, with their points."""
    rays, slope, density, valid = views.rays_and_derivative(a, pixels)
    origin, rays = views.sights(
        np.full(len(rays), a), rays, views.delay(a, pixels, motion), motion.twist
    )
    far = views.centres[b] - views.centres[a]
    steps = np.linalg.norm(far) * density.max(initial=1.0) * (1 / NEAREST - 1 / FARTHEST) / STEP
    inverse_depth = np.linspace(1 / FARTHEST, 1 / NEAREST, max(int(steps), 8))
    points = origin[:, None] + rays[:, None] / inverse_depth[None, :, None]
    late = views.later(points, views.delay(b, pixels, motion), motion)  # as if in the same row
    where, J, seen = views.project_jacobian(b, late)
    A = (J / inverse_depth[None, :, None, None]) @ slope[:, None]
    scores = patches.correlations(
        images[a], pixels, images[b], where, A, seen & valid[:, None], 1.0
    )
    index, distinct = _best(scores)
    rows = np.flatnonzero(distinct)
    if not len(rows):
        return StereoMatches(rows, np.zeros((0, 2)), np.zeros((0, 3)), np.zeros((0, 3)))
    best = index[rows]
    planes = _Planes(rays[rows], slope[rows], 1.0 / inverse_depth[best], J[rows, best])
    templates, _ = patches.templates_at(images[a], pixels[rows])
    found, fit, normal = planes.aligned(templates, images[b], where[rows, best])
    return _triangulated(views, (a, b), (origin[rows], rays[rows]), rows, found, fit > _ALIKE,
                         noise_px, normal, motion)  # fmt: skip


def _best(scores: Float[Array, "n H"]) -> tuple[Int[Array, "n"], Bool[Array, "n"]]:
    """The best candidate of every corner, and whether no other peak comes near it."""
    index = scores.argmax(1)
    best = scores.max(1)
    peak = np.zeros(scores.shape, bool)
    inner = scores[:, 1:-1]
    peak[:, 1:-1] = (inner >= scores[:, :-2]) & (inner >= scores[:, 2:])
    peak &= np.abs(np.arange(scores.shape[1]) - index[:, None]) >= _APART
    rival = np.where(peak, scores, -1.0).max(1)
    return index, (best > _ALIKE) & (best - rival > _DISTINCT)


@dataclass(frozen=True, eq=False)
class _Planes:
    """Points on rays, with the orientations that a surface there is likely to have."""

    ray: Float[Array, "m 3"]
    slope: Float[Array, "m 3 2"]
    distance: Float[Array, "m"]
    J: Float[Array, "m 2 3"]  # of the other view's pixel by the point

    def normals(self) -> list[Float[Array, "m 3"]]:
        """Facing the ray; the floor (the head's up); a wall that faces the head."""
        flat = self.ray * [1.0, 1.0, 0.0]
        return [self.ray, np.tile(UP, (len(self.ray), 1)), unit(flat)]

    def aligned(
        self, templates: Float[Array, "m S"], image: UInt8[Array, "H W"],
        start: Float[Array, "m 2"],
    ) -> tuple[Float[Array, "m 2"], Float[Array, "m"], Float[Array, "m 3"]]:  # fmt: skip
        """Pixels, correlations and normals of the orientation that correlates best."""
        pixels, score = start.copy(), np.full(len(start), -1.0)
        best = self.ray.copy()
        for normal in self.normals():
            A = self.J @ surface_slope(self.ray, self.slope, self.distance, normal)
            found, fit = patches.align(templates, image, start, A, 8, 2.5)
            better = fit > score + _LEAST_GAIN
            pixels[better], score[better], best[better] = found[better], fit[better], normal[better]
        return pixels, score, best


def _triangulated(
    views: Views, pair: tuple[int, int], sights: tuple[Float[Array, "m 3"], Float[Array, "m 3"]],
    rows: Array, found: Float[Array, "m 2"], good: Bool[Array, "m"], noise_px: float,
    normal: Float[Array, "m 3"], motion: Motion,
) -> StereoMatches:  # fmt: skip
    (a, b), (origin, rays) = pair, sights
    seen, valid = views.rays(b, found)
    late = views.delay(b, found, motion)
    centre, other = views.sights(np.full(len(seen), b), seen, late, motion.twist)
    points, distance = intersect(origin, rays, centre, other)
    back, _ = views.project(b, views.later(points, late, motion))
    good = good & valid & (distance > NEAREST) & (distance < 2 * FARTHEST)
    good &= np.linalg.norm(back - found, axis=1) < max(_EPIPOLAR, _OFF_SIGMAS * noise_px)
    _, density = views.ray_derivative(a, rays)
    parallax = np.linalg.norm(np.cross(rays, other), axis=1)
    with np.errstate(divide="ignore"):
        sigma = np.sqrt(2.0) * noise_px / density * distance / parallax
    good &= sigma < 0.3 * distance
    return StereoMatches(rows[good], found[good], points[good], normal[good])


def intersect(
    o1: Float[Array, "n 3"], d1: Float[Array, "n 3"],
    o2: Float[Array, "n 3"], d2: Float[Array, "n 3"],
) -> tuple[Float[Array, "n 3"], Float[Array, "n"]]:  # fmt: skip
    """Points on the rays o1 + s d1 nearest to the rays from o2, and s [m]; s < 0 is behind."""
    across = o2 - o1
    cosine = (d1 * d2).sum(1)
    sine2 = np.maximum(1.0 - cosine**2, 1e-12)
    s = ((d1 * across).sum(1) - cosine * (d2 * across).sum(1)) / sine2
    return o1 + s[:, None] * d1, s
