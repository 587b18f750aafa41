"""Heels and toes of the tracked skeleton, in the head frame and in the world, with derivatives.

A heel lies behind the ankle, as far below it as the foot's end point: a flat foot has both at the
same height. The head pose may be corrected: T_world_head exp(turn) + shift.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numba import njit
from numpy import ndarray as Array

from egocap.body.kinematics import KinematicTree, kinematic_tree, pose_skeleton
from egocap.body.proportions import Proportions
from egocap.body.skeleton import DOF_COUNT, DOF_JOINT, MOVES, POINT_INDEX, HasOffsets
from egocap.geometry import exponential, right_jacobian, skew

POINTS = 4
"""Left heel, left toe, right heel, right toe: `egocap.data.track.CONTACTS`."""
CORRECTION = 6
"""Unknowns of a head pose: turn (rotation vector, head frame, rad), shift (world, m)."""
STATE = DOF_COUNT + CORRECTION
HEEL_SHARE = 0.3
"""Distance of the heel behind the ankle, as a share of the foot's end point before it."""
SOLE_M = 0.033
"""Height of heel and toe points above the ground under a flat foot, m: of the simulated people's
toe landmark, with soles of shoes."""
_FEET = tuple(POINT_INDEX[f"{side}_foot"] for side in ("left", "right"))


def with_heels(proportions: HasOffsets) -> Proportions:
    """The skeleton whose feet end at the heels."""
    offsets = np.array(proportions.offsets)
    offsets[list(_FEET), :2] *= -HEEL_SHARE
    return Proportions(offsets)


@dataclass(frozen=True, eq=False)
class FootPoints:
    """Heels and toes of a person's skeleton."""

    toes: KinematicTree
    heels: KinematicTree

    @classmethod
    def of(cls, proportions: HasOffsets) -> FootPoints:
        """Those of some proportions."""
        return cls(kinematic_tree(proportions), kinematic_tree(with_heels(proportions)))

    def in_head(
        self, angles: Float[Array, "T 37"]
    ) -> tuple[Float[Array, "T 4 3"], Float[Array, "T 4 3 37"]]:
        """Positions in the head frame, m, and their derivatives by the angles."""
        points = np.empty((len(angles), POINTS, 3))
        J = np.zeros((len(angles), POINTS, 3, DOF_COUNT))
        feet = np.array(_FEET)
        _fill(self.toes, self.heels, np.ascontiguousarray(angles), feet, MOVES[feet],
              np.array(DOF_JOINT), points, J)  # fmt: skip
        return points, J

    def in_world(
        self, state: Float[Array, "T 43"], T_world_head: Float[Array, "T 4 4"]
    ) -> tuple[Float[Array, "T 4 3"], Float[Array, "T 4 3 43"]]:
        """Positions in the world, m, and their derivatives by angles, turn and shift."""
        head, J = self.in_head(state[:, :DOF_COUNT])
        turn, shift = state[:, DOF_COUNT : DOF_COUNT + 3], state[:, DOF_COUNT + 3 :]
        R = T_world_head[:, :3, :3] @ exponential(turn)
        points = np.einsum("tij,tkj->tki", R, head) + (T_world_head[:, :3, 3] + shift)[:, None]
        D = np.empty((len(state), POINTS, 3, STATE))
        D[..., :DOF_COUNT] = R[:, None] @ J
        turned = R[:, None] @ skew(head) @ right_jacobian(turn)[:, None]
        D[..., DOF_COUNT : DOF_COUNT + 3] = -turned
        D[..., DOF_COUNT + 3 :] = np.eye(3)
        return points, D


def correct(
    T_world_head: Float[Array, "T 4 4"], correction: Float[Array, "T 6"], known: Bool[Array, "T"]
) -> Float[Array, "T 4 4"]:
    """Head poses with their corrections, where they are known."""
    fixed = T_world_head.copy()
    fixed[known, :3, :3] = T_world_head[known, :3, :3] @ exponential(correction[known, :3])
    fixed[known, :3, 3] += correction[known, 3:]
    return fixed


@njit(cache=True)
def _fill(toes, heels, angles, feet, moves, dof_joint, points, J):
    """Positions (T,4,3) of heels and toes, and their derivatives (T,4,3,37), into the last two."""
    for t in range(len(angles)):
        at_toes, axes = pose_skeleton(toes, angles[t])
        at_heels, _ = pose_skeleton(heels, angles[t])
        for side in range(2):
            for part in range(2):
                k = 2 * side + part
                X = at_heels[feet[side]] if part == 0 else at_toes[feet[side]]
                points[t, k] = X
                for d in range(angles.shape[1]):
                    if not moves[side, d]:
                        continue
                    a, o = axes[d], at_toes[dof_joint[d]]
                    x, y, z = X[0] - o[0], X[1] - o[1], X[2] - o[2]
                    J[t, k, 0, d] = a[1] * z - a[2] * y
                    J[t, k, 1, d] = a[2] * x - a[0] * z
                    J[t, k, 2, d] = a[0] * y - a[1] * x
