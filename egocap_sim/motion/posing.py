"""Pose the standard figure from a few curves: pelvis, trunk, gaze, ankles, wrists."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.geometry import axis_angle, unit
from egocap_sim.bodies import BODIES, INDEX
from egocap_sim.motion import figure
from egocap_sim.motion.clip import Clip
from egocap_sim.motion.curves import turn
from egocap_sim.motion.legs import shortest_arc
from egocap_sim.motion.limbs import two_bones

SIDES = (("l_", 1.0), ("r_", -1.0))
FULL_LEG = 0.996  # of its length: the pelvis sinks rather than a leg being straighter
FULL_ARM = 0.985


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
    """Radians the elbow is raised about the line shoulder to wrist from where it would hang."""
    splay: Float[Array, "T 2"] | None = None
    """Radians each knee points outward from the way the hips face; None: it goes with the foot.

    Given, elbows too turn smoothly wherever the hands go; else they hang as in ordinary motions.
    """


def pose_figure(name: str, fps: float, controls: Controls) -> Clip:
    """Solve the figure's 21 bodies for the controls; canonical rotations."""
    T = len(controls.pelvis)
    R = np.broadcast_to(np.eye(3), (T, len(BODIES), 3, 3)).copy()
    _trunk(controls, R)
    for i, (side, sign) in enumerate(SIDES):
        _clavicle(controls, R, side, sign, i)
    pelvis = _within_reach(controls, R)
    p = figure.positions(R, pelvis)
    for i, (side, sign) in enumerate(SIDES):
        _leg(controls, R, p, side, sign, i)
        _arm(controls, R, p, side, sign, i)
    return Clip(name, fps, figure.positions(R, pelvis), R, canonical=True)


def _trunk(c: Controls, R: Float[Array, "T 21 3 3"]) -> None:
    R[:, INDEX["pelvis"]], R[:, INDEX["chest"]] = c.pelvis_R, c.chest_R
    R[:, INDEX["head"]] = c.head_R
    R[:, INDEX["spine"]] = _between(c.pelvis_R, c.chest_R, 0.5)
    R[:, INDEX["neck"]] = _between(c.chest_R, c.head_R, 0.45)


def _between(
    a: Float[Array, "T 3 3"], b: Float[Array, "T 3 3"], share: float
) -> Float[Array, "T 3 3"]:
    from scipy.spatial.transform import Rotation

    v = Rotation.from_matrix(np.swapaxes(a, 1, 2) @ b).as_rotvec()
    return a @ Rotation.from_rotvec(share * v).as_matrix()


def _clavicle(c: Controls, R: Float[Array, "T 21 3 3"], side: str, sign: float, i: int) -> None:
    """The shoulder girdle follows the arm: up when it is raised, forward when it reaches."""
    w = c.wrist[:, i]
    length = figure.UPPERARM + figure.FOREARM
    raised = np.arccos(np.clip(-unit(w)[:, 2], -1.0, 1.0))
    lift = 0.28 * np.clip(raised - 0.7, 0.0, None)
    ahead = 0.22 * np.clip(w[:, 0] / length, 0.0, 1.0) * np.linalg.norm(w, axis=1) / length
    local = turn(yaw=-sign * ahead, roll=sign * lift)
    R[:, INDEX[side + "clavicle"]] = R[:, INDEX["chest"]] @ local


def _within_reach(c: Controls, R: Float[Array, "T 21 3 3"]) -> Float[Array, "T 3"]:
    """Pelvis positions lowered, smoothly, to where both legs reach their ankles."""
    from scipy.ndimage import gaussian_filter1d, minimum_filter1d

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


def _leg(
    c: Controls, R: Float[Array, "T 21 3 3"], p: Float[Array, "T 21 3"], side: str, sign: float,
    i: int,
) -> None:  # fmt: skip
    foot = c.foot_R[:, i]
    if c.splay is None:
        level = foot[:, :, 0] * [1.0, 1.0, 0.0]
        towards = unit(0.65 * unit(level) + 0.35 * R[:, INDEX["pelvis"], :, 0])
        towards = towards + 0.3 * foot[:, :, 2]  # keeps a side when the shank lies level
    else:
        hip = unit(c.ankle[:, i] - p[:, INDEX[side + "thigh"]])
        swing = shortest_arc(-R[:, INDEX["pelvis"], :, 2], hip) @ R[:, INDEX["pelvis"]]
        towards = (swing @ turn(yaw=sign * c.splay[:, i]))[:, :, 0]
    thigh, calf = two_bones(
        p[:, INDEX[side + "thigh"]], c.ankle[:, i], towards, figure.THIGH, figure.CALF, knee=True
    )
    R[:, INDEX[side + "thigh"]], R[:, INDEX[side + "calf"]] = thigh, calf
    R[:, INDEX[side + "foot"]] = foot
    R[:, INDEX[side + "toe"]] = foot @ turn(pitch=-c.toe[:, i])


def _arm(
    c: Controls, R: Float[Array, "T 21 3 3"], p: Float[Array, "T 21 3"], side: str, sign: float,
    i: int,
) -> None:  # fmt: skip
    chest = R[:, INDEX["chest"]]
    w = c.wrist[:, i]
    rest = p[:, INDEX["chest"]] + chest @ figure.offset(side + "upperarm", "chest")
    shoulder = p[:, INDEX[side + "upperarm"]]
    length = np.linalg.norm(w, axis=1, keepdims=True)
    w = w * np.minimum(1.0, FULL_ARM * (figure.UPPERARM + figure.FOREARM) / length)
    end = rest + np.einsum("tij,tj->ti", chest, w)
    side_of = _elbow_side if c.splay is None else _elbow_anywhere
    towards = np.einsum("tij,tj->ti", chest, side_of(w, sign))
    axis = unit(end - shoulder)
    swivel = axis_angle(axis, -sign * np.broadcast_to(c.swivel[:, i], len(w)))
    towards = np.einsum("tij,tj->ti", swivel, towards)
    upper, lower = two_bones(shoulder, end, towards, figure.UPPERARM, figure.FOREARM, knee=False)
    # Pronation turns about the forearm; wrist and elbow share it as radius and hand do.
    lower = lower @ turn(yaw=-sign * 0.6 * c.pronation[:, i])
    hand = lower @ turn(yaw=-sign * 0.4 * c.pronation[:, i]) @ turn(roll=sign * c.wrist_bend[:, i])
    for body, rotation in (("upperarm", upper), ("forearm", lower), ("hand", hand)):
        R[:, INDEX[side + body]] = rotation


def _elbow_side(w: Float[Array, "T 3"], sign: float) -> Float[Array, "T 3"]:
    """Where an elbow hangs, in the chest's frame: back and down; outward when the hand is high."""
    high = np.clip(unit(w)[:, 2], 0.0, 1.0)
    side = np.stack([-0.5 + 0.9 * high, sign * (0.35 + 0.6 * high), np.full(len(w), -0.8)], axis=-1)
    return unit(side)


def _elbow_anywhere(w: Float[Array, "T 3"], sign: float) -> Float[Array, "T 3"]:
    """Where an elbow points, in the chest's frame: smooth for all but a hand straight behind and
    across, where none goes.

    Down with the hand before or beside the body, back with the arm hanging, ahead and out with it
    raised.
    """
    mirror = np.array([1.0, sign, 1.0])
    axis = unit(w * mirror)
    ahead = np.broadcast_to(unit(np.array([0.8, 0.6, 0.0])), axis.shape)
    down = shortest_arc(ahead, axis) @ np.array([0.0, 0.0, -1.0])
    outward = axis_angle(axis, 1.1 * np.maximum(-axis[:, 2], 0.0) ** 2)
    return np.einsum("tij,tj->ti", outward, down) * mirror
