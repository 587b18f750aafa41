"""Where a lost arm may be: random everyday poses of it, compared with the pictures at once.

Local descent does not find an arm that it lost. Poses of one arm are drawn from the learned prior
on postures, given the rest of the body. Each is drawn as spheres over the small pictures, which
costs some microseconds; the best one is worth an exact refinement if it explains the pictures far
better than the arm's present pose.

Source: hypotheses scored by silhouettes, e.g. Deutscher & Reid 2005, "Articulated body motion
capture by stochastic search"; the conditional Gaussian: Bishop 2006, section 2.3.1.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray as Array

from egocap.appearance.surface_kernel import first_hit, limb_costs, moved_centres
from egocap.body.gaussians import RADIUS_SIGMAS, GaussianBody
from egocap.body.skeleton import DOFS, JOINTS, LIMITS
from egocap.cameras.rig import Rig
from egocap.image_model.body_kernel import gaussian_centres, make_chain
from egocap.image_model.image_rays import ImageRays, pixel_angle, ray_numbers
from egocap.pose.pose_prior import load_posture

SIDES = ("left", "right")
POSES = 500
"""Poses that are compared."""
GATE = 6.0
"""Pixels that fit wholly by which the best must explain more than the present pose."""
_ANGLES = ("clavicle", "shoulder", "elbow", "wrist")
_JOINTS = ("shoulder", "elbow", "wrist")
_WIDER = 1.3
"""Over the mean pixels of a sphere's radius: a fisheye's scale changes over the picture."""


class ArmSearch:
    """Poses of one arm, `SIDES[side]`. Not to be shared between threads."""

    def __init__(self, rig: Rig, rays: ImageRays, body: GaussianBody, side: int) -> None:
        self._rig, self._rays, self._body = rig.resized(*rays.size), rays, body
        self._chain = make_chain(body)
        self.angles: Bool[Array, "37"] = _named(DOFS, SIDES[side], _ANGLES)
        self.joints: Bool[Array, "17"] = _named([j.name for j in JOINTS], SIDES[side], _JOINTS)
        radius, carrier = RADIUS_SIGMAS * body.sigma, self._chain.carrier
        mine = (carrier >= 0) & self.joints[carrier]
        self._arm, self._rest = np.flatnonzero(mine), np.flatnonzero(~mine)
        self._radius, self._rest_radius = radius[mine], radius[~mine]
        self._eyes = np.ascontiguousarray(rays.origins)
        self._index = ray_numbers(rays)
        self._pixel = pixel_angle(self._rig.cameras[0])
        posture = load_posture()
        free, given = np.flatnonzero(self.angles), np.flatnonzero(~self.angles)
        spread = np.linalg.inv(posture.precision[np.ix_(free, free)])
        self._slope = -spread @ posture.precision[np.ix_(free, given)]
        self._mean = posture.mean
        normal = np.random.default_rng(side).normal(size=(POSES, len(free)))
        self._scatter = normal @ np.linalg.cholesky(spread).T

    def propose(
        self, angles: Float[Array, "37"], unlike: Float32[Array, "91 P"]
    ) -> Float[Array, "37"] | None:
        """The pose that explains the rays' colours best, None if not better by `GATE`.

        `unlike` is every ray's dissimilarity to every Gaussian.
        """
        poses = np.concatenate([angles[None], self._draw(angles)])
        costs = self._costs(poses, unlike)
        best = int(np.argmin(costs))
        return poses[best] if costs[best] < costs[0] - GATE else None

    def _draw(self, angles: Float[Array, "37"]) -> Float[Array, "N 37"]:
        free, given = self.angles, ~self.angles
        poses = np.tile(angles, (POSES, 1))
        middle = self._mean[free] + self._slope @ (angles - self._mean)[given]
        poses[:, free] = np.clip(middle + self._scatter, *LIMITS[free].T)
        return poses

    def _costs(
        self, poses: Float[Array, "N 37"], unlike: Float32[Array, "91 P"]
    ) -> Float[Array, "N"]:
        """What each pose adds to the rays' dissimilarities, against a body without the arm."""
        depth, which = np.empty(len(self._rays)), np.empty(len(self._rays), np.int64)
        body = gaussian_centres(poses[:1], self._body)[0][self._rest]
        first_hit(
            self._eyes, body, self._rest_radius, 1.0, self._rays.view, self._rays.direction,
            depth, which,
        )  # fmt: skip
        hit = np.isfinite(depth)
        behind = np.where(hit, unlike[self._rest[which], np.arange(len(depth))], 0.0)
        centres = np.empty((len(poses), len(self._arm), 3))
        moved_centres(self._chain, poses, self._arm, centres)
        pixels, inside = self._rig.project(centres)
        pixels = np.where(inside[..., None], pixels, np.nan)
        distance = np.linalg.norm(centres - self._eyes[:, None, None], axis=-1)
        angle = np.arcsin(np.clip(self._radius / distance, 0.0, 0.9))
        costs = np.empty(len(poses))
        limb_costs(
            self._eyes, pixels, _WIDER * angle / self._pixel + 1.0, centres, self._arm,
            self._radius, self._index, self._rays.direction, unlike, behind, depth, costs,
        )  # fmt: skip
        return costs


def _named(names, side: str, parts: tuple[str, ...]) -> Bool[Array, "N"]:
    words = [name.split("_") for name in names]
    return np.array([w[0] == side and w[1] in parts for w in words])
