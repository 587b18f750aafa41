"""What a rig sees of everyday poses: share of time of every joint, and its Cramer-Rao bound.

Poses are drawn from the learned pose prior; joints are occluded by the volumetric body. The bound
is that of a single frame, Bayesian: detections of every visible joint and the pose prior.
`egocap-eval rig` does the same over simulated motions and a rendered person.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.gaussians import GaussianBody
from egocap.body.labels import EVALUATED, LABELS
from egocap.body.proportions import Proportions
from egocap.body.skeleton import LIMITS, MIRROR_DOFS, MIRROR_SIGNS, forward
from egocap.cameras.rig import Rig
from egocap.image_model.occlusion import joints_seen
from egocap.pose.pose_prior import load_posture
from egocap.posterior.information import (
    Noise,
    fisher_information,
    joint_covariance,
    prior_information,
    rms_mm,
)


@dataclass(frozen=True, eq=False)
class RigCoverage:
    """Measures of every label, the head included, over some poses."""

    any_view: Float[Array, "18"]  # share of poses in which at least one view sees the joint
    all_views: Float[Array, "18"]
    bound_mm: Float[Array, "18"]  # root mean square over the poses

    @property
    def summary(self) -> dict[str, float]:
        """Means over the evaluated joints; the bound's root mean square."""
        joints = list(EVALUATED)
        return {
            "any_view": float(self.any_view[joints].mean()),
            "all_views": float(self.all_views[joints].mean()),
            "bound_mm": float(np.sqrt((self.bound_mm[joints] ** 2).mean())),
        }

    def to_dict(self) -> dict[str, float | dict[str, dict[str, float]]]:
        """JSON-ready form."""
        lines = zip(LABELS, self.any_view, self.all_views, self.bound_mm, strict=True)
        return self.summary | {
            "joints": {
                name: {"any_view": round(float(a), 3), "all_views": round(float(b), 3),
                       "bound_mm": round(float(c), 1)}
                for name, a, b, c in lines
            }
        }  # fmt: skip


def everyday_poses(count: int, rng: np.random.Generator) -> Float[Array, "B 37"]:
    """Poses drawn from the pose prior and their mirrors, moved inside the anatomical limits.

    An odd `count` leaves out the last mirror.
    """
    posture = load_posture()
    half = -(-count // 2)
    drawn = rng.multivariate_normal(posture.mean, np.linalg.inv(posture.precision), half)
    both = np.stack([drawn, drawn[:, MIRROR_DOFS] * MIRROR_SIGNS], 1).reshape(-1, len(MIRROR_SIGNS))
    return np.clip(both[:count], LIMITS[:, 0], LIMITS[:, 1])


def rig_coverage(
    rig: Rig, proportions: Proportions, poses: Float[Array, "B 37"], sigma: float = 2.0
) -> RigCoverage:
    """Visibility and bound; `sigma` is that of detections, pixels at an image width of 640."""
    joints = np.ascontiguousarray(forward(proportions, poses))
    seen = joints_seen(poses, joints, GaussianBody.from_proportions(proportions), rig)
    known = fisher_information(poses, proportions, rig, seen, Noise(sigma))
    covariance = np.linalg.inv(known + prior_information(poses))
    bound = rms_mm(joint_covariance(poses, proportions, covariance))
    return RigCoverage(seen.any(1).mean(0), seen.all(1).mean(0), np.sqrt((bound**2).mean(0)))
