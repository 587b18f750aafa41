"""The standard figure's bodies from a motion's controls, frame by frame, compiled."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float
from numba import njit
from numpy import ndarray as Array

from egocap_sim.core.bodies import INDEX
from egocap_sim.motion.kinematics.forward_kinematics import hang
from egocap_sim.motion.kinematics.limbs import bent
from egocap_sim.motion.kinematics.vectors import (
    Axes,
    Vector,
    about,
    applied,
    arc,
    axes,
    difference,
    length,
    mirrored,
    part_way,
    plus,
    product,
    put,
    scaled,
    turned,
    unit,
    vector,
)

SIDES = (("l_", 1.0), ("r_", -1.0))

_FULL_ARM = 0.985  # of its length: a farther wrist is brought back
_PELVIS, _SPINE, _CHEST, _NECK, _HEAD = (
    INDEX[body] for body in ("pelvis", "spine", "chest", "neck", "head")
)
_CLAVICLE, _UPPERARM, _FOREARM, _HAND, _THIGH, _CALF, _FOOT, _TOE = (
    tuple(INDEX[side + part] for side, _ in SIDES)
    for part in ("clavicle", "upperarm", "forearm", "hand", "thigh", "calf", "foot", "toe")
)
_SIGN = tuple(sign for _, sign in SIDES)


@njit(cache=True)
def solve(
    pelvis: Float[Array, "T 3"],
    trunk: Float[Array, "T 3 3 3"],
    ankle: Float[Array, "T 2 3"],
    foot_R: Float[Array, "T 2 3 3"],
    toe: Float[Array, "T 2"],
    wrist: Float[Array, "T 2 3"],
    hand: Float[Array, "T 2 3"],
    splay: Float[Array, "T 2"],
    anywhere: bool,
    offset: Float[Array, "21 3"],
) -> tuple[Float[Array, "T 21 3"], Float[Array, "T 21 3 3"]]:
    """Joint positions and rotations of the figure for `posing.Controls`.

    `trunk` are the rotations of pelvis, chest and head, `hand` pronation, bend and swivel. `splay`
    counts where limbs go `anywhere`. `offset`: see `forward_kinematics.offsets`; the figure is
    as long on the right as on the left.
    """
    T, bodies = len(pelvis), len(offset)
    thigh_m, calf_m, upperarm_m, forearm_m = [
        length(vector(offset[body])) for body in (_CALF[0], _FOOT[0], _FOREARM[0], _HAND[0])
    ]
    arm_m = upperarm_m + forearm_m
    p, R = np.zeros((T, bodies, 3)), np.zeros((T, bodies, 3, 3))
    p[:, 0] = pelvis
    for t in range(T):
        hips, chest, head = axes(trunk[t, 0]), axes(trunk[t, 1]), axes(trunk[t, 2])
        put(R[t, _PELVIS], hips)
        put(R[t, _SPINE], part_way(hips, chest, 0.5))
        put(R[t, _CHEST], chest)
        put(R[t, _NECK], part_way(chest, head, 0.45))
        put(R[t, _HEAD], head)
        for i in range(2):
            put(R[t, _CLAVICLE[i]], product(chest, _clavicle(vector(wrist[t, i]), arm_m, _SIGN[i])))
        hang(offset, R[t], p[t])
        for i in range(2):
            foot, leg = axes(foot_R[t, i]), difference(ankle[t, i], p[t, _THIGH[i]])
            side = _knee_out(hips, leg, _SIGN[i] * splay[t, i]) if anywhere else _knee(hips, foot)
            thigh, calf = bent(leg, side, thigh_m, calf_m, True)
            _put_leg(R[t], i, thigh, calf, foot, toe[t, i])
            w = _in_reach(vector(wrist[t, i]), _FULL_ARM * arm_m)
            from_chest = plus(vector(offset[_CLAVICLE[i]]), vector(offset[_UPPERARM[i]]))
            lifted = difference(p[t, _UPPERARM[i]], p[t, _CHEST])
            arm = plus(applied(chest, plus(from_chest, w)), lifted, -1.0)
            side = _elbow_anywhere(w, _SIGN[i]) if anywhere else _elbow(w, _SIGN[i])
            side = applied(about(unit(arm), -_SIGN[i] * hand[t, i, 2]), applied(chest, side))
            upper, lower = bent(arm, side, upperarm_m, forearm_m, False)
            _put_arm(R[t], i, upper, lower, hand[t, i, 0], hand[t, i, 1])
        hang(offset, R[t], p[t])
    return p, R


@njit(cache=True)
def _put_leg(
    R: Float[Array, "21 3 3"], i: int, thigh: Axes, calf: Axes, foot: Axes, toe: float
) -> None:
    put(R[_THIGH[i]], thigh)
    put(R[_CALF[i]], calf)
    put(R[_FOOT[i]], foot)
    put(R[_TOE[i]], product(foot, turned(0.0, -toe, 0.0)))


@njit(cache=True)
def _put_arm(
    R: Float[Array, "21 3 3"], i: int, upper: Axes, lower: Axes, pronation: float, bend: float
) -> None:
    """Pronation turns about the forearm; wrist and elbow share it as radius and hand do."""
    twist = -_SIGN[i] * pronation
    forearm = product(lower, turned(0.6 * twist, 0.0, 0.0))
    hand = product(forearm, turned(0.4 * twist, 0.0, 0.0))
    put(R[_UPPERARM[i]], upper)
    put(R[_FOREARM[i]], forearm)
    put(R[_HAND[i]], product(hand, turned(0.0, 0.0, _SIGN[i] * bend)))


@njit(cache=True)
def _clavicle(wrist: Vector, arm_m: float, sign: float) -> Axes:
    """The shoulder girdle follows the arm: up when it is raised, forward when it reaches."""
    far = length(wrist) / arm_m
    raised = math.acos(min(max(-unit(wrist)[2], -1.0), 1.0))
    lift = 0.28 * max(raised - 0.7, 0.0)
    ahead = 0.22 * min(max(wrist[0] / arm_m, 0.0), 1.0) * far
    return turned(-sign * ahead, 0.0, sign * lift)


@njit(cache=True)
def _knee(hips: Axes, foot: Axes) -> Vector:
    """Where a knee points: mostly as the foot does."""
    level = unit((foot[0][0], foot[0][1], 0.0))
    towards = unit(plus(scaled(level, 0.65), hips[0], 0.35))
    return plus(towards, foot[2], 0.3)  # keeps a side when the shank lies level


@njit(cache=True)
def _knee_out(hips: Axes, leg: Vector, splay: float) -> Vector:
    """Where a knee points that is turned out from the way the hips face."""
    swing = product(arc(scaled(hips[2], -1.0), unit(leg)), hips)
    return product(swing, turned(splay, 0.0, 0.0))[0]


@njit(cache=True)
def _in_reach(wrist: Vector, reach: float) -> Vector:
    """A wrist brought to where the arm reaches it."""
    return scaled(wrist, min(1.0, reach / max(length(wrist), 1e-9)))


@njit(cache=True)
def _elbow(wrist: Vector, sign: float) -> Vector:
    """Where an elbow hangs, in the chest's frame: back and down; outward when the hand is high."""
    high = min(max(unit(wrist)[2], 0.0), 1.0)
    return unit((-0.5 + 0.9 * high, sign * (0.35 + 0.6 * high), -0.8))


@njit(cache=True)
def _elbow_anywhere(wrist: Vector, sign: float) -> Vector:
    """Where an elbow points, in the chest's frame: smooth for all but a hand straight behind and
    across, where none goes.

    Down with the hand before or beside the body, back with the arm hanging, ahead and out with it
    raised.
    """
    axis = unit(mirrored(wrist, sign))
    down = applied(arc((0.8, 0.6, 0.0), axis), (0.0, 0.0, -1.0))
    outward = about(axis, 1.1 * max(-axis[2], 0.0) ** 2)
    return mirrored(applied(outward, down), sign)
