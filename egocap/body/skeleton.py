"""The tracker's skeleton: 17 joints with 37 rotational degrees of freedom, rooted at the head.

The cameras are fixed to the skull, so it is the root of the kinematic tree: the neck rotates the
trunk relative to the head, the lower spine the pelvis relative to the chest. A pose is 37 angles p
in radians; p = 0 stands upright with the arms hanging. Every angle is a twist about an axis that is
fixed in the rest pose, and a joint's transform is the product of the exponentials of its twists,
outermost first, after those of its ancestors.

Signs: flexion, abduction, elevation, protraction and external rotation are positive on both sides;
the right side mirrors the left, so equal angles are mirror-symmetric poses. Turning and leaning of
the spine are positive when the body below turns or leans to the person's left.

Axes are ordered so that gimbal lock occurs in rare poses: for spine, neck and hip at 90 degrees of
side bend or abduction. The shoulder is raised in the plane of the scapula (45 degrees between
forward and sideways), swung out of that plane, then rotated about the upper arm: it locks with the
arm level and 45 degrees across the chest or 45 degrees behind the frontal plane, both at the end of
its range, and is regular with the arm hanging, forward, sideways and overhead.

Source: EgoCap 2016, sections 4.1 and 4.2.1; Murray, Li & Sastry 1994, ch. 3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.labels import LABELS, other_side
from egocap.geometry import axis_angle, unit

DOF_COUNT = 37


@dataclass(frozen=True)
class Dof:
    """One angle of a joint: a twist about an axis given in the rest pose (head axes)."""

    name: str
    axis: tuple[float, float, float]
    lower_deg: float
    upper_deg: float
    spread_deg: float  # standard deviation of everyday poses; scales the pose prior
    agility_deg: float  # of its acceleration, deg/s^1.5 (see AGILITY); scales smoothing


@dataclass(frozen=True)
class Joint:
    """An articulated joint: its parent and its angles, outermost first."""

    name: str
    parent: str | None  # None: fixed to the skull
    dofs: tuple[Dof, ...]
    source: str  # of the limits


_D = float(np.sqrt(0.5))
_INCLINATION, _DEVIATION = np.deg2rad(42.0), np.deg2rad(23.0)
_SUBTALAR = (
    -float(np.cos(_INCLINATION) * np.cos(_DEVIATION)),
    float(np.cos(_INCLINATION) * np.sin(_DEVIATION)),
    -float(np.sin(_INCLINATION)),
)
"""Axis of the left foot's inversion: 42 degrees up, 23 medial (Inman 1976)."""

_SPINE = (
    Joint(
        "neck",
        None,
        (
            Dof("neck_turn", (0, 0, 1), -80, 80, 25, 65),
            Dof("neck_lean", (1, 0, 0), -45, 45, 12, 50),
            Dof("neck_flexion", (0, -1, 0), -60, 60, 20, 80),
        ),
        "whole cervical spine, Kapandji vol. 3: turn 80-90 each way, side bend 45, flexion and "
        "extension 130 in all; the joint's share of it differs between people and motion sources",
    ),
    Joint(
        "upper_spine",
        "neck",
        (
            Dof("upper_spine_turn", (0, 0, 1), -60, 60, 15, 55),
            Dof("upper_spine_lean", (1, 0, 0), -45, 45, 12, 50),
            Dof("upper_spine_flexion", (0, -1, 0), -60, 60, 20, 85),
        ),
        "lower cervical and upper thoracic spine; AAOS 1965, cervical: rotation 60, side bend 45, "
        "flexion and extension 45 each, and some of the thoracic range (Kapandji vol. 3)",
    ),
    Joint(
        "lower_spine",
        "upper_spine",
        (
            Dof("lower_spine_turn", (0, 0, 1), -45, 45, 15, 85),
            Dof("lower_spine_lean", (1, 0, 0), -40, 40, 12, 95),
            Dof("lower_spine_flexion", (0, -1, 0), -45, 90, 25, 105),
        ),
        "thoracolumbar spine; AAOS 1965: rotation 45, side bend 35, flexion 80, extension 25; "
        "Kapandji vol. 3: 40, 40, 105, 60",
    ),
)

_LEFT = (
    Joint(
        "left_clavicle",
        "upper_spine",
        (
            Dof("left_clavicle_protraction", (0, 0, -1), -20, 30, 10, 65),
            Dof("left_clavicle_elevation", (1, 0, 0), -10, 45, 12, 30),
        ),
        "Kapandji vol. 1, the outer end of the clavicle moves 10 cm up, 3 cm down, 10 cm forward, "
        "3 cm back on a bone of about 15 cm",
    ),
    Joint(
        "left_shoulder",
        "left_clavicle",
        (
            Dof("left_shoulder_raise", (_D, -_D, 0), -60, 180, 50, 125),
            Dof("left_shoulder_swing", (_D, _D, 0), -85, 85, 35, 105),
            Dof("left_shoulder_rotation", (0, 0, 1), -110, 110, 45, 240),
        ),
        "AAOS 1965: elevation 180, extension 60, horizontal flexion 135 and extension 45 from "
        "sideways; axial rotation 70 in, 90 out, widened by what raising adds in these axes",
    ),
    Joint(
        "left_elbow",
        "left_shoulder",
        (Dof("left_elbow_flexion", (0, -1, 0), -5, 150, 50, 220),),
        "AAOS 1965: flexion 150; Boone & Azen 1979: extension to 0.6 +- 3.1 below straight",
    ),
    Joint(
        "left_wrist",
        "left_elbow",
        (
            Dof("left_wrist_abduction", (1, 0, 0), -80, 80, 25, 155),
            Dof("left_wrist_flexion", (0, -1, 0), -80, 80, 25, 170),
        ),
        "AAOS 1965: flexion 80, extension 70, deviation 20 and 30; as the forearm does not turn "
        "in this skeleton, either axis may carry the wide range",
    ),
    Joint(
        "left_hip",
        "lower_spine",
        (
            Dof("left_hip_flexion", (0, -1, 0), -30, 125, 35, 195),
            Dof("left_hip_abduction", (1, 0, 0), -30, 50, 12, 110),
            Dof("left_hip_rotation", (0, 0, 1), -45, 50, 20, 165),
        ),
        "AAOS 1965: flexion 120, extension 30, abduction 45, adduction 30, rotation 45 each way; "
        "Kapandji vol. 2: external rotation to 60",
    ),
    Joint(
        "left_knee",
        "left_hip",
        (Dof("left_knee_flexion", (0, 1, 0), -5, 150, 45, 375),),
        "AAOS 1965: flexion 135, hyperextension 10; Kapandji vol. 2: flexion 140, passively 160",
    ),
    Joint(
        "left_ankle",
        "left_knee",
        (
            Dof("left_ankle_flexion", (0, -1, 0), -50, 35, 18, 360),
            Dof("left_ankle_inversion", _SUBTALAR, -40, 35, 15, 255),
        ),
        "AAOS 1965: plantar flexion 50, dorsiflexion 20, inversion 35, eversion 15; Kapandji "
        "vol. 2: dorsiflexion 30; eversion to 40, as the bent knee turns out",
    ),
)


def _mirrored(joint: Joint) -> Joint:
    """Right-hand joint of a left one; a twist's axis is a pseudo-vector, so x and z are negated."""
    dofs = tuple(
        replace(d, name=other_side(d.name), axis=(-d.axis[0], d.axis[1], -d.axis[2]))
        for d in joint.dofs
    )
    name, parent = other_side(joint.name), other_side(joint.parent or "")
    return replace(joint, name=name, parent=parent, dofs=dofs)


_ARM, _LEG = _LEFT[:4], _LEFT[4:]
JOINTS: tuple[Joint, ...] = (
    *_SPINE, *_ARM, *map(_mirrored, _ARM), *_LEG, *map(_mirrored, _LEG)
)  # fmt: skip
"""The 17 joints, parents before children."""

END_POINTS: dict[str, str | None] = {
    "head": None, "left_hand": "left_wrist", "right_hand": "right_wrist",
    "left_foot": "left_ankle", "right_foot": "right_ankle",
}  # fmt: skip
"""End points of the skeleton and the joint that carries each (None: the skull)."""

POINTS: tuple[str, ...] = tuple(j.name for j in JOINTS) + tuple(END_POINTS)
POINT_INDEX: dict[str, int] = {name: i for i, name in enumerate(POINTS)}
POINT_COUNT = len(POINTS)
_PARENT_NAMES = {j.name: j.parent for j in JOINTS} | END_POINTS
POINT_PARENTS: tuple[int, ...] = tuple(
    -1 if (parent := _PARENT_NAMES[name]) is None else POINT_INDEX[parent] for name in POINTS
)
"""Index of the joint that carries each point; -1 is the skull."""

DOFS: tuple[str, ...] = tuple(d.name for j in JOINTS for d in j.dofs)
DOF_INDEX: dict[str, int] = {name: i for i, name in enumerate(DOFS)}
DOF_JOINT: tuple[int, ...] = tuple(i for i, j in enumerate(JOINTS) for _ in j.dofs)
"""Index of the joint each angle belongs to."""

_DOFS_OF: tuple[Sequence[int], ...] = tuple(
    [d for d, joint in enumerate(DOF_JOINT) if joint == i] for i in range(len(JOINTS))
)
AXES: Float[Array, "37 3"] = unit(np.array([d.axis for j in JOINTS for d in j.dofs], float))
LIMITS: Float[Array, "37 2"] = np.deg2rad(
    [(d.lower_deg, d.upper_deg) for j in JOINTS for d in j.dofs]
)
SPREAD: Float[Array, "37"] = np.deg2rad([d.spread_deg for j in JOINTS for d in j.dofs])
AGILITY: Float[Array, "37"] = np.deg2rad([d.agility_deg for j in JOINTS for d in j.dofs])
"""Root of the spectral density of each angle's acceleration as white noise, rad/s^1.5.

Second differences at 30 frames/s have the standard deviation AGILITY * sqrt(30) rad/s^2. Measured,
without the largest 1 %, over walking, running, jumping, ball games and gestures of the CMU data.
"""

MIRROR_DOFS: tuple[int, ...] = tuple(DOF_INDEX[other_side(name)] for name in DOFS)
MIRROR_SIGNS: Float[Array, "37"] = np.array(
    [
        -1.0 if n.endswith(("spine_turn", "spine_lean", "neck_turn", "neck_lean")) else 1.0
        for n in DOFS
    ]
)
"""A mirrored pose is `angles[..., MIRROR_DOFS] * MIRROR_SIGNS`."""

LABEL_POINTS: tuple[int, ...] = tuple(
    POINT_INDEX["upper_spine" if label == "neck" else label] for label in LABELS
)
"""Index of the point of each detection label: joints, and the ends of head, hands and feet."""


def _ancestry() -> Bool[Array, "22 37"]:
    moves = np.zeros((POINT_COUNT, len(DOFS)), bool)
    for i, parent in enumerate(POINT_PARENTS):
        if parent >= 0:
            moves[i] = moves[parent] | (np.array(DOF_JOINT) == parent)
    return moves


MOVES: Bool[Array, "22 37"] = _ancestry()
"""Whether each angle moves each point."""


class HasOffsets(Protocol):
    """Rest offsets of a person, e.g. `egocap.body.proportions.Proportions`."""

    @property
    def offsets(self) -> Float[Array, "22 3"]:
        """Rest offset of every point from the joint that carries it, metres, head axes."""
        ...


def forward(
    proportions: HasOffsets, angles: Float[Array, "*batch 37"]
) -> Float[Array, "*batch 18 3"]:
    """Joint positions in the head frame, metres, in the order of `egocap.body.labels.LABELS`."""
    return points(proportions, angles)[..., LABEL_POINTS, :]


def points(
    proportions: HasOffsets, angles: Float[Array, "*batch 37"]
) -> Float[Array, "*batch 22 3"]:
    """Positions of all `POINTS` in the head frame, metres."""
    return _chain(proportions.offsets, angles)[0]


def rest_points(proportions: HasOffsets) -> Float[Array, "22 3"]:
    """Positions of all `POINTS` in the rest pose, head frame, metres."""
    where = np.zeros((POINT_COUNT, 3))
    for i, parent in enumerate(POINT_PARENTS):
        where[i] = proportions.offsets[i] + (where[parent] if parent >= 0 else 0.0)
    return where


def jacobian(
    proportions: HasOffsets, angles: Float[Array, "*batch 37"]
) -> tuple[Float[Array, "*batch 18 3"], Float[Array, "*batch 18 3 37"]]:
    """Joint positions and their derivatives by the angles, metres per radian.

    An angle rotates its descendants about its posed axis a through its joint o, so the derivative
    of a point x is a x (x - o).  Source: Murray, Li & Sastry 1994, section 3.4 (spatial Jacobian).
    """
    positions, axes, _ = _chain(proportions.offsets, angles)
    centres = positions[..., DOF_JOINT, :]
    labels = positions[..., LABEL_POINTS, :]
    arms = labels[..., :, None, :] - centres[..., None, :, :]  # (..., 18, 37, 3)
    J = np.cross(axes[..., None, :, :], arms) * MOVES[list(LABEL_POINTS), :, None]
    return labels, np.swapaxes(J, -1, -2)


def joint_rotations(angles: Float[Array, "*batch 37"]) -> Float[Array, "*batch 17 3 3"]:
    """Rotation of every joint's frame in the head frame; identity in the rest pose."""
    return _chain(np.zeros((POINT_COUNT, 3)), angles)[2]


def _chain(
    offsets: Float[Array, "22 3"], angles: Float[Array, "*batch 37"]
) -> tuple[Float[Array, "*batch 22 3"], Float[Array, "*batch 37 3"], Float[Array, "*batch 17 3 3"]]:
    """Positions of all points, posed axes of all angles and joint rotations, head frame."""
    angles = np.asarray(angles, float)
    assert angles.shape[-1] == DOF_COUNT, angles.shape
    batch = angles.shape[:-1]
    positions = np.zeros((*batch, POINT_COUNT, 3))
    axes = np.zeros((*batch, DOF_COUNT, 3))
    turns = axis_angle(AXES, angles)  # (..., 37, 3, 3)
    rotations: list[Float[Array, "*batch 3 3"]] = []
    for i, parent in enumerate(POINT_PARENTS):
        R = np.broadcast_to(np.eye(3), (*batch, 3, 3)) if parent < 0 else rotations[parent]
        origin = 0.0 if parent < 0 else positions[..., parent, :]
        positions[..., i, :] = origin + R @ offsets[i]
        if i < len(JOINTS):
            for d in _DOFS_OF[i]:
                axes[..., d, :] = R @ AXES[d]
                R = R @ turns[..., d, :, :]
            rotations.append(R)
    return positions, axes, np.stack(rotations, -3)


assert len(DOFS) == DOF_COUNT and len(JOINTS) == 17
