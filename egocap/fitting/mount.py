"""The pose of the rig against the skull as a parameter of a fit, and the neutral stance.

A rig file is off by a rigid motion (R, t): a camera that it places at T_head_camera is at
[R t] T_head_camera. Shared parameters are the components of the body, then R's rotation vector w,
then t. Detections are cast with the rig as given, so that a joint x is compared as
x' = R^T (x - t), with dx' = [x']_x J_r(w) dw - R^T dt.

The neck turns about the origin of the head frame in all three angles. So a rotation of the rig and
the opposite angles of the neck in every frame leave every joint where it is in the images: only
priors on the pose determine R. The neutral stance is one that a wearer can be asked for: upright,
looking at the horizon straight ahead, body and limbs near the rest pose, the centre of mass above
the support, and shoulders, hips and ankles square to the gaze.

Source: Sola et al. 2018, "A micro Lie theory", equation 143 (J_r). Cooke & Wei 1988 (the head's
natural position is repeated within 2 degrees).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.linalg import block_diag

from egocap.body.skeleton import DOFS
from egocap.fitting.bundle_adjustment import FitProblem, FitSystem, Joints, joint_derivatives
from egocap.fitting.stance import attitude
from egocap.geometry import exponential, right_jacobian, skew

PARAMETERS = ("roll", "pitch", "yaw", "forward", "left", "up")
"""Rotation about and translation along the head's axes."""
NEUTRAL_DEG = {"neck": 3.0, "upper_spine": 3.0, "lower_spine": 5.0, "clavicle": 6.0, "hip": 6.0,
               "knee": 6.0, "ankle": 6.0}  # fmt: skip
"""Standard deviation of a joint's angles in the neutral stance. The arms are free."""
ATTITUDE_DEG = np.array([2.0, 1.5, 2.5])
"""Standard deviations, in the neutral stance, of the tangents of `stance`."""


@dataclass(frozen=True, eq=False)
class MountPrior:
    """Body and mount together."""

    mean: Float[Array, "K"]
    covariance: Float[Array, "K K"]

    @classmethod
    def around(
        cls, mean: Float[Array, "K"], covariance: Float[Array, "K K"], rotation: float,
        position: float,
    ) -> MountPrior:  # fmt: skip
        """A body prior and a rig file right within `rotation` [rad] and `position` [m]."""
        spread = np.repeat([rotation, position], 3) ** 2
        both = np.asarray(block_diag(covariance, np.diag(spread)))
        return cls(np.append(mean, np.zeros(6)), both)


@dataclass(frozen=True, eq=False)
class MountProblem(FitProblem):
    """A fit of body and mount. `neutral`: as `stance.neutral_weights` gives it."""

    neutral: Float[Array, "T 4"]

    def joints(self, shared: Float[Array, "K"], poses: Float[Array, "T 37"]) -> Joints:
        """Labelled joints in the frame of the rig as given."""
        w, t = shared[-6:-3], shared[-3:]
        R = exponential(w)
        labels, by_angle, by_body = joint_derivatives(shared[:-6], poses)
        moved = (labels - t) @ R
        by_mount = np.concatenate(
            [skew(moved) @ right_jacobian(w), np.broadcast_to(-R.T, (*moved.shape, 3))], -1
        )
        return Joints(moved, R.T @ by_angle, np.concatenate([R.T @ by_body, by_mount], -1))

    def further(
        self, shared: Float[Array, "K"], poses: Float[Array, "T 37"], system: FitSystem
    ) -> float:
        """The neutral stance: angles near rest, the centre of mass above the support."""
        stands = self.neutral.any(1)
        if not stands.any():
            return 0.0
        weight, at = self.neutral[stands], poses[stands]
        own, precision = np.arange(len(DOFS)), weight[:, :1] * NEUTRAL_PRECISION
        system.g_pose[stands] += precision * at
        system.pose[np.flatnonzero(stands)[:, None], own, own] += precision
        off, by_angle, by_body = attitude(shared[:-6], at)
        scaled = weight[:, 1:] / np.deg2rad(ATTITUDE_DEG) ** 2
        system.g_pose[stands] += np.einsum("ti,tid,ti->td", scaled, by_angle, off)
        system.pose[stands] += np.einsum("ti,tid,tie->tde", scaled, by_angle, by_angle)
        system.cross[stands, :, :-6] += np.einsum("ti,tid,tik->tdk", scaled, by_angle, by_body)
        system.body[:-6, :-6] += np.einsum("ti,tik,tim->km", scaled, by_body, by_body)
        system.g_body[:-6] += np.einsum("ti,tik,ti->k", scaled, by_body, off)
        return float(0.5 * (precision * at**2).sum() + 0.5 * (scaled * off**2).sum())


def _neutral_precision() -> Float[Array, "37"]:
    spreads = [
        next((deg for kind, deg in NEUTRAL_DEG.items() if kind in name), np.inf) for name in DOFS
    ]
    return np.deg2rad(spreads) ** -2.0


NEUTRAL_PRECISION: Float[Array, "37"] = _neutral_precision()
