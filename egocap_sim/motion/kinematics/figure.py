"""A standard adult: joint positions of the 21 bodies at rest, and forward kinematics.

Procedural motions are made on this figure; retargeting scales them to a person. Proportions are
fractions of the height.

Source: R. Drillis and R. Contini, Body Segment Parameters (1966), as in D. Winter, Biomechanics and
Motor Control of Human Movement, figure 4.1 (segment lengths, hip and shoulder height and breadth);
joint centres of the trunk lie on a line through hip and neck.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from numba import njit
from numpy import ndarray as Array

from egocap_sim.core.bodies import BODIES, INDEX, PARENTS

HEIGHT = 1.75  # metres

_SHARE: dict[str, tuple[float, float, float]] = {
    "pelvis": (0.0, 0.0, 0.540), "spine": (-0.008, 0.0, 0.600), "chest": (-0.010, 0.0, 0.700),
    "neck": (-0.006, 0.0, 0.835), "head": (0.006, 0.0, 0.885),
}  # fmt: skip
for _s, _y in (("l_", 1.0), ("r_", -1.0)):
    _SHARE |= {
        _s + "clavicle": (0.006, 0.020 * _y, 0.815), _s + "upperarm": (-0.008, 0.110 * _y, 0.818),
        _s + "forearm": (-0.008, 0.110 * _y, 0.632), _s + "hand": (-0.008, 0.110 * _y, 0.486),
        _s + "thigh": (0.0, 0.050 * _y, 0.530), _s + "calf": (0.0, 0.050 * _y, 0.285),
        _s + "foot": (0.0, 0.050 * _y, 0.039), _s + "toe": (0.080, 0.050 * _y, 0.012),
    }  # fmt: skip

REST: Float[Array, "21 3"] = HEIGHT * np.array([_SHARE[b] for b in BODIES])
"""Rest joint positions, metres: standing on z = 0, arms straight down, facing +x."""
SOLE_HEEL = HEIGHT * np.array([-0.032, 0.0, -0.039])
"""Back of the sole, in the foot's frame."""
SOLE_BALL = HEIGHT * np.array([0.080, 0.0, -0.039])
"""Sole under the toe joint, in the foot's frame."""
SOLE_TIP = HEIGHT * np.array([0.040, 0.0, -0.012])
"""Front of the sole, in the toe's frame."""

THIGH = float(np.linalg.norm(REST[INDEX["l_calf"]] - REST[INDEX["l_thigh"]]))
CALF = float(np.linalg.norm(REST[INDEX["l_foot"]] - REST[INDEX["l_calf"]]))
UPPERARM = float(np.linalg.norm(REST[INDEX["l_forearm"]] - REST[INDEX["l_upperarm"]]))
FOREARM = float(np.linalg.norm(REST[INDEX["l_hand"]] - REST[INDEX["l_forearm"]]))


def offset(body: str, parent: str) -> Float[Array, "3"]:
    """Rest position of a body's joint relative to that of another, metres."""
    return REST[INDEX[body]] - REST[INDEX[parent]]


def positions(
    rotations: Float[Array, "T 21 3 3"], pelvis: Float[Array, "T 3"]
) -> Float[Array, "T 21 3"]:
    """World joint positions of the figure under world rotations of its bodies."""
    return joint_positions(REST, pelvis, rotations)


def leg_length(positions: Float[Array, "*batch J 3"], joints: Mapping[str, int] = INDEX) -> float:
    """Length from hip to knee to ankle, the mean over frames and both sides."""
    bones = [
        np.linalg.norm(
            positions[..., joints[s + a], :] - positions[..., joints[s + b], :], axis=-1
        ).mean()
        for s in ("l_", "r_")
        for a, b in (("thigh", "calf"), ("calf", "foot"))
    ]
    return float(2 * np.mean(bones))


def joint_positions(
    rest: Float[Array, "21 3"], root: Float[Array, "T 3"], rotations: Float[Array, "T 21 3 3"]
) -> Float[Array, "T 21 3"]:
    """World joint positions of a skeleton with joints at `rest` under world rotations, metres."""
    p = np.empty((len(rotations), len(PARENTS), 3))
    p[:, 0] = root
    _place_all(bone_offsets(rest), np.ascontiguousarray(rotations, float), p)
    return p


def bone_offsets(rest: Float[Array, "21 3"]) -> Float[Array, "21 3"]:
    """Rest position of each joint relative to its parent's; the root's position is absolute."""
    parents = np.array(PARENTS[1:])
    return np.concatenate([rest[:1], rest[1:] - rest[parents]])


@njit(cache=True)
def place_joints(
    offset: Float[Array, "21 3"], rotations: Float[Array, "21 3 3"], p: Float[Array, "21 3"]
) -> None:
    """Forward kinematics of one frame: write all joints but the root, p[0]."""
    for b in range(1, len(p)):
        parent = PARENTS[b]
        for i in range(3):
            p[b, i] = p[parent, i]
            for j in range(3):
                p[b, i] += rotations[parent, i, j] * offset[b, j]


@njit(cache=True)
def _place_all(
    offset: Float[Array, "21 3"], rotations: Float[Array, "T 21 3 3"], p: Float[Array, "T 21 3"]
) -> None:
    for t in range(len(p)):
        place_joints(offset, rotations[t], p[t])
