"""Two-bone inverse kinematics of a leg or an arm: its end moves; its root and its plane stay."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.geometry import skew, unit
from egocap_sim.core.bodies import INDEX

_LEG, _ARM = ("thigh", "calf", "foot"), ("upperarm", "forearm", "hand")
_REACH = 0.999  # of the leg's length: a straighter knee has no side


def bend_leg(
    positions: Float[Array, "T 21 3"],
    rotations: Float[Array, "T 21 3 3"],
    side: str,
    move: Float[Array, "T 3"],
) -> Float[Array, "T 21 3 3"]:
    """Turn thigh and calf of side 'l' or 'r' so that the ankle moves by `move` metres.

    Farther than the leg reaches the ankle goes as far as it can. Foot and toes keep their
    orientation; the knee stays in its plane through hip and ankle.
    """
    return _bend(positions, rotations, [f"{side}_{part}" for part in _LEG], move, 1.0)


def bend_arm(
    positions: Float[Array, "T 21 3"],
    rotations: Float[Array, "T 21 3 3"],
    side: str,
    move: Float[Array, "T 3"],
) -> Float[Array, "T 21 3 3"]:
    """The same for an arm: the wrist moves, the hand keeps its orientation."""
    return _bend(positions, rotations, [f"{side}_{part}" for part in _ARM], move, -1.0)


def _bend(
    positions: Float[Array, "T 21 3"],
    rotations: Float[Array, "T 21 3 3"],
    parts: list[str],
    move: Float[Array, "T 3"],
    straight: float,
) -> Float[Array, "T 21 3 3"]:
    thigh, calf, foot = (INDEX[part] for part in parts)
    hip, knee, ankle = positions[:, thigh], positions[:, calf], positions[:, foot]
    upper, lower = (
        np.linalg.norm(knee - hip, axis=1, keepdims=True),
        np.linalg.norm(ankle - knee, axis=1, keepdims=True),
    )
    reach = ankle + move - hip
    distance = np.linalg.norm(reach, axis=1, keepdims=True)
    # A leg that is straighter already may stay so.
    far = np.maximum(_REACH * (upper + lower), np.linalg.norm(ankle - hip, axis=1, keepdims=True))
    distance = np.clip(distance, np.abs(upper - lower) * 1.01, far)
    towards = unit(reach)
    swing = shortest_arc(unit(ankle - hip), towards)
    bent = _apply(swing, knee - hip)
    # A straight knee has no plane of its own: it then bends to the front of the thigh,
    # an elbow to the back of the arm.
    ahead = bent + straight * 1e-4 * rotations[:, thigh, :, 0]
    out = unit(ahead - (ahead * towards).sum(1, keepdims=True) * towards)
    along = (distance**2 + upper**2 - lower**2) / (2 * distance)
    new_knee = along * towards + np.sqrt(np.maximum(upper**2 - along**2, 0.0)) * out
    shin = distance * towards - new_knee
    turned = rotations.copy()
    turned[:, thigh] = shortest_arc(unit(bent), unit(new_knee)) @ swing @ rotations[:, thigh]
    old_shin = _apply(swing, ankle - knee)
    turned[:, calf] = shortest_arc(unit(old_shin), unit(shin)) @ swing @ rotations[:, calf]
    return turned


def shortest_arc(a: Float[Array, "*n 3"], b: Float[Array, "*n 3"]) -> Float[Array, "*n 3 3"]:
    """The smallest rotations that turn unit vectors a into unit vectors b (not opposite ones)."""
    K = skew(np.cross(a, b))
    cosine = (a * b).sum(-1)[..., None, None]
    return np.eye(3) + K + K @ K / (1.0 + cosine)


def _apply(R: Float[Array, "T 3 3"], v: Float[Array, "T 3"]) -> Float[Array, "T 3"]:
    return np.einsum("tij,tj->ti", R, v)
