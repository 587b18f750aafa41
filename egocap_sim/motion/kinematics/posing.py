"""Pose the standard figure from a few curves: pelvis, trunk, gaze, ankles, wrists; compiled."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numba import njit
from numpy import ndarray as Array
from scipy.ndimage import gaussian_filter1d, minimum_filter1d

from egocap_sim.core.bodies import INDEX
from egocap_sim.motion.kinematics import figure
from egocap_sim.motion.kinematics.clip import Clip
from egocap_sim.motion.kinematics.limbs import solve_limb
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
)  # fmt: skip

SIDES = (("l_", 1.0), ("r_", -1.0))

FULL_LEG = 0.996  # of its length: the pelvis is lowered so that no leg gets straighter
_FULL_ARM = 0.985  # of its length: a farther wrist target is clamped
_PELVIS, _SPINE, _CHEST, _NECK, _HEAD = (
    INDEX[body] for body in ("pelvis", "spine", "chest", "neck", "head")
)
_CLAVICLE, _UPPERARM, _FOREARM, _HAND, _THIGH, _CALF, _FOOT, _TOE = (
    tuple(INDEX[side + part] for side, _ in SIDES)
    for part in ("clavicle", "upperarm", "forearm", "hand", "thigh", "calf", "foot", "toe")
)
_SIGN = tuple(sign for _, sign in SIDES)


@dataclass(eq=False)
class Controls:
    """Curves of a motion; T frames, sides left then right. World frame unless said otherwise."""

    pelvis: Float[Array, "T 3"]  # joint position
    pelvis_R: Float[Array, "T 3 3"]
    chest_R: Float[Array, "T 3 3"]
    head_R: Float[Array, "T 3 3"]
    ankle: Float[Array, "T 2 3"]
    foot_R: Float[Array, "T 2 3 3"]
    toe: Float[Array, "T 2"]  # radians the toes bend up from the foot
    wrist: Float[Array, "T 2 3"]  # from the shoulder at rest, in the chest's frame
    pronation: Float[Array, "T 2"]  # radians; 0 is thumb up, positive turns the palm down
    wrist_bend: Float[Array, "T 2"]  # radians; positive towards the palm's back (extension)
    swivel: Float[Array, "T 2"] = field(default_factory=lambda: np.zeros((1, 2)))
    """Radians the elbow is raised from hanging, about the line from shoulder to wrist."""
    splay: Float[Array, "T 2"] | None = None
    """Radians each knee points outward from the facing of the hips; None: as the foot points.

    If given, elbow directions are smooth for all hand positions; otherwise they are tuned to
    ordinary motions.
    """


class _Curves(NamedTuple):
    """`Controls` as the compiled solver takes them; `trunk` is pelvis, chest, head."""

    pelvis: Float[Array, "T 3"]
    trunk: Float[Array, "T 3 3 3"]
    ankle: Float[Array, "T 2 3"]
    foot_R: Float[Array, "T 2 3 3"]
    toe: Float[Array, "T 2"]
    wrist: Float[Array, "T 2 3"]
    hand: Float[Array, "T 2 3"]  # pronation, bend and swivel
    splay: Float[Array, "T 2"]


def pose_figure(name: str, fps: float, controls: Controls) -> Clip:
    """Solve the figure's 21 bodies for the controls; canonical rotations."""
    c, T = controls, len(controls.pelvis)
    swivel = np.broadcast_to(c.swivel, (T, 2))
    curves = (
        _within_reach(c),
        np.stack([c.pelvis_R, c.chest_R, c.head_R], 1),
        c.ankle,
        c.foot_R,
        c.toe,
        c.wrist,
        np.stack([c.pronation, c.wrist_bend, swivel], -1),
        np.zeros((T, 2)) if c.splay is None else c.splay,
    )
    curves = _Curves(*(np.array(curve, float, order="C") for curve in curves))
    p, R = _solve(curves, c.splay is not None, figure.bone_offsets(figure.REST))
    return Clip(name, fps, p, R, canonical=True)


def aim_wrists(
    controls: Controls, wrist: Float[Array, "T 2 3"], share: Float[Array, "T 2"] | float = 1.0
) -> Controls:
    """Move the wrists of controls by a share of the way to world positions [m]."""
    clip = pose_figure("aim", 1.0, controls)
    chest, at = clip.rotations[:, INDEX["chest"]], clip.positions[:, INDEX["chest"]]
    wanted = np.empty_like(controls.wrist)
    for i, (side, _) in enumerate(SIDES):
        shoulder = at + chest @ figure.offset(side + "upperarm", "chest")
        wanted[:, i] = np.einsum("tij,ti->tj", chest, wrist[:, i] - shoulder)
    share = np.broadcast_to(share, controls.wrist.shape[:2])[..., None]
    return dataclasses.replace(controls, wrist=controls.wrist + share * (wanted - controls.wrist))


def _within_reach(c: Controls) -> Float[Array, "T 3"]:
    """Pelvis positions, lowered smoothly so that both legs reach their ankles."""
    full = FULL_LEG * (figure.THIGH + figure.CALF)
    too_high = np.zeros(len(c.pelvis))
    for i, (side, _) in enumerate(SIDES):
        hip = c.pelvis + c.pelvis_R @ figure.offset(side + "thigh", "pelvis")
        flat = np.linalg.norm((hip - c.ankle[:, i])[:, :2], axis=1)
        highest = c.ankle[:, i, 2] + np.sqrt(np.maximum(full**2 - flat**2, 0.01))
        too_high = np.maximum(too_high, hip[:, 2] - highest)
    if too_high.max() <= 0.0:
        return c.pelvis
    drop = gaussian_filter1d(-minimum_filter1d(-too_high, 7, mode="nearest"), 2.0, mode="nearest")
    return c.pelvis - np.maximum(drop, too_high)[:, None] * [0.0, 0.0, 1.0]


@njit(cache=True)
def _solve(
    c: _Curves, any_pose: bool, offset: Float[Array, "21 3"]
) -> tuple[Float[Array, "T 21 3"], Float[Array, "T 21 3 3"]]:
    """Joint positions and rotations of the figure; `splay` is used for `any_pose` only.

    Right limbs are as long as left ones.
    """
    T, bodies = len(c.pelvis), len(offset)
    p, R = np.zeros((T, bodies, 3)), np.zeros((T, bodies, 3, 3))
    p[:, 0] = c.pelvis
    for t in range(T):
        _put_trunk(R[t], c.trunk[t], c.wrist[t], offset)
        figure.place_joints(offset, R[t], p[t])
        for i in range(2):
            _put_leg(R[t], p[t], c, t, i, any_pose, offset)
            _put_arm(R[t], p[t], c, t, i, any_pose, offset)
        figure.place_joints(offset, R[t], p[t])
    return p, R


@njit(cache=True)
def _lengths(offset: Float[Array, "21 3"], middle: int, end: int) -> tuple[float, float]:
    """Lengths of a limb's two bones, from its middle joint and its end."""
    return length(vector(offset[middle])), length(vector(offset[end]))


@njit(cache=True)
def _put_trunk(
    R: Float[Array, "21 3 3"],
    trunk: Float[Array, "3 3 3"],
    wrist: Float[Array, "2 3"],
    offset: Float[Array, "21 3"],
) -> None:
    hips, chest, head = axes(trunk[0]), axes(trunk[1]), axes(trunk[2])
    put(R[_PELVIS], hips)
    put(R[_SPINE], part_way(hips, chest, 0.5))
    put(R[_CHEST], chest)
    put(R[_NECK], part_way(chest, head, 0.45))
    put(R[_HEAD], head)
    upper, lower = _lengths(offset, _FOREARM[0], _HAND[0])
    for i in range(2):
        girdle = _clavicle(vector(wrist[i]), upper + lower, _SIGN[i])
        put(R[_CLAVICLE[i]], product(chest, girdle))


@njit(cache=True)
def _put_leg(
    R: Float[Array, "21 3 3"],
    p: Float[Array, "21 3"],
    c: _Curves,
    t: int,
    i: int,
    any_pose: bool,
    offset: Float[Array, "21 3"],
) -> None:
    hips, foot = axes(c.trunk[t, 0]), axes(c.foot_R[t, i])
    leg = difference(c.ankle[t, i], p[_THIGH[i]])
    side = _knee_out(hips, leg, _SIGN[i] * c.splay[t, i]) if any_pose else _knee(hips, foot)
    upper, lower = _lengths(offset, _CALF[0], _FOOT[0])
    thigh, calf = solve_limb(leg, side, upper, lower, True)
    put(R[_THIGH[i]], thigh)
    put(R[_CALF[i]], calf)
    put(R[_FOOT[i]], foot)
    put(R[_TOE[i]], product(foot, turned(0.0, -c.toe[t, i], 0.0)))


@njit(cache=True)
def _put_arm(
    R: Float[Array, "21 3 3"],
    p: Float[Array, "21 3"],
    c: _Curves,
    t: int,
    i: int,
    any_pose: bool,
    offset: Float[Array, "21 3"],
) -> None:
    """Pose an arm; pronation turns forearm and hand about the forearm axis, 60 to 40 percent."""
    chest, sign = axes(c.trunk[t, 1]), _SIGN[i]
    upper_m, lower_m = _lengths(offset, _FOREARM[0], _HAND[0])
    w = _in_reach(vector(c.wrist[t, i]), _FULL_ARM * (upper_m + lower_m))
    from_chest = plus(vector(offset[_CLAVICLE[i]]), vector(offset[_UPPERARM[i]]))
    lifted = difference(p[_UPPERARM[i]], p[_CHEST])
    arm = plus(applied(chest, plus(from_chest, w)), lifted, -1.0)
    side = _elbow_anywhere(w, sign) if any_pose else _elbow(w, sign)
    pronation, bend, swivel = vector(c.hand[t, i])
    side = applied(about(unit(arm), -sign * swivel), applied(chest, side))
    upper, lower = solve_limb(arm, side, upper_m, lower_m, False)
    twist = -sign * pronation
    forearm = product(lower, turned(0.6 * twist, 0.0, 0.0))
    hand = product(forearm, turned(0.4 * twist, 0.0, 0.0))
    put(R[_UPPERARM[i]], upper)
    put(R[_FOREARM[i]], forearm)
    put(R[_HAND[i]], product(hand, turned(0.0, 0.0, sign * bend)))


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
    """Direction of a knee: mostly that of the foot."""
    level = unit((foot[0][0], foot[0][1], 0.0))
    towards = unit(plus(scaled(level, 0.65), hips[0], 0.35))
    return plus(towards, foot[2], 0.3)  # stays defined for a horizontal shank


@njit(cache=True)
def _knee_out(hips: Axes, leg: Vector, splay: float) -> Vector:
    """Direction of a knee, turned outward from the facing of the hips by `splay`."""
    swing = product(arc(scaled(hips[2], -1.0), unit(leg)), hips)
    return product(swing, turned(splay, 0.0, 0.0))[0]


@njit(cache=True)
def _in_reach(wrist: Vector, reach: float) -> Vector:
    """A wrist clamped to the reach of the arm."""
    return scaled(wrist, min(1.0, reach / max(length(wrist), 1e-9)))


@njit(cache=True)
def _elbow(wrist: Vector, sign: float) -> Vector:
    """Elbow direction in the chest's frame: back and down, outward for a high hand."""
    high = min(max(unit(wrist)[2], 0.0), 1.0)
    return unit((-0.5 + 0.9 * high, sign * (0.35 + 0.6 * high), -0.8))


@njit(cache=True)
def _elbow_anywhere(wrist: Vector, sign: float) -> Vector:
    """Elbow direction in the chest's frame, smooth for all reachable hand positions.

    It is down with the hand before or beside the body, back with the arm hanging, ahead and out
    with the arm raised.
    """
    axis = unit(mirrored(wrist, sign))
    down = applied(arc((0.8, 0.6, 0.0), axis), (0.0, 0.0, -1.0))
    outward = about(axis, 1.1 * max(-axis[2], 0.0) ** 2)
    return mirrored(applied(outward, down), sign)
