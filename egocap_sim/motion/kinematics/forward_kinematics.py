"""Forward kinematics: where joints are when every body is turned."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numba import njit
from numpy import ndarray as Array

from egocap_sim.core.bodies import PARENTS


def joint_positions(
    rest: Float[Array, "21 3"], root: Float[Array, "T 3"], rotations: Float[Array, "T 21 3 3"]
) -> Float[Array, "T 21 3"]:
    """World joint positions of a skeleton with joints at `rest` under world rotations, metres."""
    p = np.empty((len(rotations), len(PARENTS), 3))
    p[:, 0] = root
    _hang_all(offsets(rest), np.ascontiguousarray(rotations, float), p)
    return p


def offsets(rest: Float[Array, "21 3"]) -> Float[Array, "21 3"]:
    """Of each joint from its parent's, at rest; the root's is its place."""
    parents = np.array(PARENTS[1:])
    return np.concatenate([rest[:1], rest[1:] - rest[parents]])


@njit(cache=True)
def hang(
    offset: Float[Array, "21 3"], rotations: Float[Array, "21 3 3"], p: Float[Array, "21 3"]
) -> None:
    """Place all joints of one frame but the root, p[0]."""
    for b in range(1, len(p)):
        parent = PARENTS[b]
        for i in range(3):
            p[b, i] = p[parent, i]
            for j in range(3):
                p[b, i] += rotations[parent, i, j] * offset[b, j]


@njit(cache=True)
def _hang_all(
    offset: Float[Array, "21 3"], rotations: Float[Array, "T 21 3 3"], p: Float[Array, "T 21 3"]
) -> None:
    for t in range(len(p)):
        hang(offset, rotations[t], p[t])
