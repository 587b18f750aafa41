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
natural position is repeated within 2 degrees). Winter 1995, "Human balance and posture control",
and Winter 2009, "Biomechanics and Motor Control", table 4.1 (segment masses).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.linalg import block_diag

from egocap.body.labels import LABEL_INDEX
from egocap.body.skeleton import DOFS
from egocap.fitting.bundle_adjustment import FitProblem, FitSystem, Joints, joint_derivatives
from egocap.geometry import exponential, right_jacobian, skew

PARAMETERS = ("roll", "pitch", "yaw", "forward", "left", "up")
"""Rotation about and translation along the head's axes."""
NEUTRAL_DEG = {"neck": 3.0, "upper_spine": 3.0, "lower_spine": 5.0, "clavicle": 6.0, "hip": 6.0,
               "knee": 6.0, "ankle": 6.0}  # fmt: skip
"""Standard deviation of a joint's angles in the neutral stance. The arms are free."""
ATTITUDE_DEG = np.array([2.0, 2.0, 2.5])
"""Standard deviations, in the neutral stance, of the tangents of `stance`."""
SUPPORT = 0.35
"""Place of the centre of pressure between ankle and ball of the foot."""
_MASSES = {"head": 0.081, "shoulder": 0.2765, "elbow": 0.044, "wrist": 0.028, "hip": 0.3485,
           "knee": 0.1465, "ankle": 0.061, "foot": 0.0145}  # fmt: skip
"""Share of the body's mass at a kind of joint, both sides: half of each segment's at either end;
the trunk's at shoulders and hips."""
_PAIRS = ("shoulder", "hip", "ankle")
"""Joints whose lines from right to left are square to the gaze."""


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
    """A fit of body and mount. `neutral` weighs the frames of each neutral stance, sum 1."""

    neutral: Float[Array, "T"]

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
        stands = self.neutral > 0.0
        if not stands.any():
            return 0.0
        weight, at = self.neutral[stands], poses[stands]
        own, precision = np.arange(len(DOFS)), NEUTRAL_PRECISION
        system.g_pose[stands] += weight[:, None] * precision * at
        system.pose[np.flatnonzero(stands)[:, None], own, own] += weight[:, None] * precision
        off, by_angle, by_body = attitude(shared[:-6], at)
        scaled = weight[:, None] / np.deg2rad(ATTITUDE_DEG) ** 2
        system.g_pose[stands] += np.einsum("ti,tid,ti->td", scaled, by_angle, off)
        system.pose[stands] += np.einsum("ti,tid,tie->tde", scaled, by_angle, by_angle)
        system.cross[stands, :, :-6] += np.einsum("ti,tid,tik->tdk", scaled, by_angle, by_body)
        system.body[:-6, :-6] += np.einsum("ti,tik,tim->km", scaled, by_body, by_body)
        system.g_body[:-6] += np.einsum("ti,tik,ti->k", scaled, by_body, off)
        return float(
            0.5 * (weight[:, None] * precision * at**2).sum() + 0.5 * (scaled * off**2).sum()
        )


def stance(joints: Float[Array, "T 18 3"]) -> tuple[Float[Array, "T 3"], Float[Array, "T"]]:
    """How the body stands to the head, and the height of its mass above its support [m].

    Tangents of its lean forward and to the left against the head's vertical, and of its turn
    against the gaze.
    """
    line, across = (np.einsum("l,tli->ti", weights, joints) for weights in (WEIGHTS, ACROSS))
    tangents = np.concatenate([line[:, :2] / line[:, 2:], across[:, :1] / across[:, 1:2]], 1)
    return tangents, line[:, 2]


def attitude(
    components: Float[Array, "K"], poses: Float[Array, "T 37"]
) -> tuple[Float[Array, "T 3"], Float[Array, "T 3 37"], Float[Array, "T 3 K"]]:
    """Lean and turn of `stance`, and their derivatives by angles and components."""
    joints, *derivatives = joint_derivatives(components, poses)
    off, _ = stance(joints)
    lengths = np.stack([(WEIGHTS @ joints)[:, 2]] * 2 + [(ACROSS @ joints)[:, 1]], 1)

    def slope(by: Array) -> Array:
        line, across = (np.einsum("l,tlid->tid", weights, by) for weights in (WEIGHTS, ACROSS))
        rise = np.concatenate([line[:, :2], across[:, :1]], 1)
        run = np.stack([line[:, 2], line[:, 2], across[:, 1]], 1)
        return (rise - off[..., None] * run) / lengths[..., None]

    return off, *map(slope, derivatives)


def _weights() -> Float[Array, "18"]:
    """Centre of mass minus centre of pressure, as weights of the labels; they sum to 0."""
    weights = np.zeros(len(LABEL_INDEX))
    for name, label in LABEL_INDEX.items():
        kind = name.rpartition("_")[2]
        share = _MASSES.get(kind, 0.0)
        weights[label] = share if name == "head" else share / 2
    weights /= weights.sum()
    for side in ("left", "right"):
        weights[LABEL_INDEX[f"{side}_ankle"]] -= 0.5 * (1.0 - SUPPORT)
        weights[LABEL_INDEX[f"{side}_foot"]] -= 0.5 * SUPPORT
    return weights


def _across() -> Float[Array, "18"]:
    """Sum of the lines of `_PAIRS` from right to left, as weights of the labels."""
    weights = np.zeros(len(LABEL_INDEX))
    for kind in _PAIRS:
        weights[LABEL_INDEX[f"left_{kind}"]], weights[LABEL_INDEX[f"right_{kind}"]] = 1.0, -1.0
    return weights


def _neutral_precision() -> Float[Array, "37"]:
    spreads = [
        next((deg for kind, deg in NEUTRAL_DEG.items() if kind in name), np.inf) for name in DOFS
    ]
    return np.deg2rad(spreads) ** -2.0


WEIGHTS: Float[Array, "18"] = _weights()
ACROSS: Float[Array, "18"] = _across()
NEUTRAL_PRECISION: Float[Array, "37"] = _neutral_precision()
