"""Two-bone inverse kinematics of arms and legs: from end points (compiled), or as corrections."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float
from numba import njit
from numpy import ndarray as Array

from egocap import geometry
from egocap_sim.core.bodies import INDEX
from egocap_sim.motion.kinematics.vectors import (
    Axes,
    Vector,
    cross,
    dot,
    length,
    plus,
    put,
    scaled,
    unit,
    vector,
)  # fmt: skip

STRAIGHTEST = 0.998  # of the limb's length: farther targets are clamped
_REACH = 0.999  # of the leg's length: the bending plane of a straighter knee is undefined


def solve_limbs(
    root: Float[Array, "T 3"],
    end: Float[Array, "T 3"],
    bend_towards: Float[Array, "T 3"],
    upper: float,
    lower: float,
    *,
    knee: bool,
) -> tuple[Float[Array, "T 3 3"], Float[Array, "T 3 3"]]:
    """Canonical world rotations of the upper and lower bone (thigh and calf, or the arm's).

    The middle joint lies to the side of `bend_towards`. A knee's hinge is the body's left axis; an
    elbow's flexion turns the other way about it.
    """
    upper_R, lower_R = np.empty((len(root), 3, 3)), np.empty((len(root), 3, 3))
    reach = np.ascontiguousarray(end - root)
    _bend_all(reach, np.array(bend_towards, order="C"), upper, lower, knee, upper_R, lower_R)
    return upper_R, lower_R


@njit(cache=True)
def _bend_all(
    reach: Float[Array, "T 3"],
    bend_towards: Float[Array, "T 3"],
    upper: float,
    lower: float,
    knee: bool,
    upper_R: Float[Array, "T 3 3"],
    lower_R: Float[Array, "T 3 3"],
) -> None:
    for t in range(len(reach)):
        a, b = solve_limb(vector(reach[t]), vector(bend_towards[t]), upper, lower, knee)
        put(upper_R[t], a)
        put(lower_R[t], b)


@njit(cache=True)
def solve_limb(
    reach: Vector, bend_towards: Vector, upper: float, lower: float, knee: bool
) -> tuple[Axes, Axes]:
    """`solve_limbs` of one frame, `reach` from the root to the end."""
    distance = length(reach)
    axis = scaled(reach, 1.0 / max(distance, 1e-9))
    nearest, farthest = abs(upper - lower) * 1.05 + 0.02, STRAIGHTEST * (upper + lower)
    distance = min(max(distance, nearest), farthest)
    side = unit(plus(bend_towards, axis, -dot(bend_towards, axis)))
    along = (distance**2 + upper**2 - lower**2) / (2.0 * distance)
    out = math.sqrt(max(upper**2 - along**2, 0.0))
    middle = plus(scaled(axis, along), side, out)
    left = cross(side, axis) if knee else cross(axis, side)
    return _bone(middle, left), _bone(plus(scaled(axis, distance), middle, -1.0), left)


@njit(cache=True)
def _bone(down: Vector, left: Vector) -> Axes:
    z = scaled(unit(down), -1.0)
    return cross(left, z), left, z


def bend_angle(upper: Float[Array, "*n 3 3"], lower: Float[Array, "*n 3 3"]) -> Float[Array, "*n"]:
    """Angle about the left axis from upper to lower bone [rad]: positive for a flexed knee."""
    local = np.swapaxes(upper, -1, -2) @ lower
    return np.arctan2(local[..., 0, 2], local[..., 2, 2])


def bend_limb(
    positions: Float[Array, "T 21 3"],
    rotations: Float[Array, "T 21 3 3"],
    side: str,
    move: Float[Array, "T 3"],
    *,
    arm: bool = False,
) -> Float[Array, "T 21 3 3"]:
    """Turn thigh and calf, or the arm, of side 'l' or 'r' so that its end moves by `move` metres.

    Beyond the limb's reach the end goes as far as it can. Foot and hand keep their orientation;
    the middle joint stays in its plane through root and end.
    """
    parts = ("upperarm", "forearm", "hand") if arm else ("thigh", "calf", "foot")
    thigh, calf, foot = (INDEX[f"{side}_{part}"] for part in parts)
    hip, knee, ankle = positions[:, thigh], positions[:, calf], positions[:, foot]
    upper = np.linalg.norm(knee - hip, axis=1, keepdims=True)
    lower = np.linalg.norm(ankle - knee, axis=1, keepdims=True)
    reach = ankle + move - hip
    distance = np.linalg.norm(reach, axis=1, keepdims=True)
    # A leg that is already straighter keeps its length.
    far = np.maximum(_REACH * (upper + lower), np.linalg.norm(ankle - hip, axis=1, keepdims=True))
    distance = np.clip(distance, np.abs(upper - lower) * 1.01, far)
    towards = geometry.unit(reach)
    swing = shortest_arc(geometry.unit(ankle - hip), towards)
    bent = np.einsum("tij,tj->ti", swing, knee - hip)
    # The plane of a straight limb is undefined: a knee then bends to the front of the thigh,
    # an elbow to the back of the arm.
    ahead = bent + (-1e-4 if arm else 1e-4) * rotations[:, thigh, :, 0]
    out = geometry.unit(ahead - (ahead * towards).sum(1, keepdims=True) * towards)
    along = (distance**2 + upper**2 - lower**2) / (2 * distance)
    new_knee = along * towards + np.sqrt(np.maximum(upper**2 - along**2, 0.0)) * out
    shin = distance * towards - new_knee
    turned = rotations.copy()
    swung = np.einsum("tij,tj->ti", swing, ankle - knee)
    for body, before, after in ((thigh, bent, new_knee), (calf, swung, shin)):
        arc = shortest_arc(geometry.unit(before), geometry.unit(after))
        turned[:, body] = arc @ swing @ rotations[:, body]
    return turned


def shortest_arc(a: Float[Array, "*n 3"], b: Float[Array, "*n 3"]) -> Float[Array, "*n 3 3"]:
    """The smallest rotations that turn unit vectors a into unit vectors b (not opposite ones)."""
    K = geometry.skew(np.cross(a, b))
    cosine = (a * b).sum(-1)[..., None, None]
    return np.eye(3) + K + K @ K / (1.0 + cosine)
