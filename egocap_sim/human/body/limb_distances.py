"""Sample points inside limbs, and distances between two people."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap_sim.core.bodies import BODIES, INDEX, PARENTS


def limb_points(bodies: Float[Array, "T 21 4 4"]) -> Float[Array, "T P 3"]:
    """Points for distance checks: joints, middles of bones, fingertips."""
    p = bodies[..., :3, 3]
    middles = (p[:, 1:] + p[:, np.array(PARENTS[1:])]) / 2
    tips = []
    for side in ("l_", "r_"):
        hand, forearm = p[:, INDEX[side + "hand"]], p[:, INDEX[side + "forearm"]]
        # Fingers end half a forearm beyond the hand joint.
        tips.append((2.0 * hand - forearm + hand) / 2)
    return np.concatenate([p, middles, np.stack(tips, 1)], 1)


RIGHT_ARM = tuple(
    i
    for i, body in enumerate([*BODIES, *BODIES[1:], "l_hand", "r_hand"])
    if body in ("r_forearm", "r_hand")
)
"""Columns of `limb_points` beyond the right elbow."""


def apart(a: Float[Array, "T P 3"], b: Float[Array, "T P 3"], gap: float) -> Bool[Array, "T"]:
    """In which frames all points of one person are at least `gap` metres from the other's."""
    far = np.linalg.norm(a[:, 0] - b[:, 0], axis=-1) > 2.4  # beyond the reach of two people
    result = np.ones(len(a), bool)
    for k in np.flatnonzero(~far):
        d = a[k, :, None] - b[k, None]
        result[k] = np.einsum("pqi,pqi->pq", d, d).min() >= gap * gap
    return result
