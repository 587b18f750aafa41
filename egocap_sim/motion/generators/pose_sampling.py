"""Where legs, trunk and head are in poses drawn at random: one function a kind of pose.

Each returns a pose with hanging arms whose feet, or knees, are on the ground. Ranges are those of
healthy adults.

Source: American Academy of Orthopaedic Surgeons, Joint Motion: Method of Measuring and Recording
(1965), for the ranges of motion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from egocap_sim.core.bodies import INDEX
from egocap_sim.motion.generators.stance import HIP_HEIGHT
from egocap_sim.motion.generators.whole_pose import (
    TOE_HEIGHT,
    Foot,
    WholePose,
    centred,
    figure_in,
    on_ground,
    over_feet,
    settled,
    stood,
    with_ankle_at,
)
from egocap_sim.motion.kinematics import figure
from egocap_sim.motion.kinematics.curves import turn

KNEE_HEIGHT = 0.075  # metres of the knee joint of someone kneeling on it
_HIP_Y = float(figure.offset("l_thigh", "pelvis")[1])
_HIP_Z = float(figure.offset("l_thigh", "pelvis")[2])

Rng = np.random.Generator


def _normal(rng: Rng, spread: float, most: float) -> float:
    return float(np.clip(rng.normal(0.0, spread), -most, most))


def _looked(rng: Rng, pose: WholePose, size: float) -> WholePose:
    """The head turned on the chest: anywhere, often far, and down oftener than up, as hands are."""
    yaw = _normal(rng, 0.55, 1.2) * size
    pitch = float(rng.triangular(-0.7, 0.3, 0.75)) * size
    tilt = _normal(rng, 0.2, 0.5) * size
    return replace(pose, look=(yaw, pitch, tilt))


def reach(rng: Rng, size: float) -> WholePose:
    """Stand, legs more or less bent and apart, trunk turned and leant."""
    feet = stood(
        float(rng.uniform(0.07, 0.24)), _normal(rng, 0.1, 0.25), float(rng.uniform(0.0, 0.4))
    )
    down = float(rng.beta(1.0, 2.5)) * 0.36 * size
    yaw, roll = _normal(rng, 0.3, 0.6) * size, _normal(rng, 0.17, 0.35) * size
    pitch = float(rng.triangular(-0.25, 0.05, 0.9)) * size
    pose = WholePose(
        pelvis=(-0.3 * down, 0.0, HIP_HEIGHT - down),
        hips=(0.3 * yaw, 0.45 * pitch, 0.3 * roll), chest=(yaw, pitch, roll), feet=feet,
        over=over_feet(feet, float(rng.uniform(0.3, 0.7))),
    )  # fmt: skip
    return _looked(rng, centred(pose), size)


def bend(rng: Rng, size: float) -> WholePose:
    """Bend far forward over nearly straight or bent legs."""
    feet = stood(
        float(rng.uniform(0.07, 0.3)), _normal(rng, 0.1, 0.3), float(rng.uniform(0.0, 0.3))
    )
    down = 0.02 + float(rng.beta(1.0, 1.5)) * 0.38
    pitch = float(rng.triangular(0.9, 2.1, 2.3)) * (0.6 + 0.4 * size)
    yaw, roll = _normal(rng, 0.25, 0.6), _normal(rng, 0.15, 0.35)
    pose = WholePose(
        pelvis=(-0.08, 0.0, HIP_HEIGHT - down),
        hips=(0.4 * yaw, 0.55 * pitch, 0.3 * roll), chest=(yaw, pitch, roll), feet=feet,
        over=over_feet(feet, float(rng.uniform(0.35, 0.65))),
    )  # fmt: skip
    return _looked(rng, centred(pose), size)


def crouch(rng: Rng, size: float) -> WholePose:
    """Squat low, heels down or raised, knees together or apart: the feet come near the hands."""
    width, heel = float(rng.uniform(0.07, 0.24)), float(rng.choice([0.0, rng.uniform(0.2, 0.9)]))
    apart = float(rng.uniform(0.05, 0.75))
    stagger = _normal(rng, 0.08, 0.2)
    left, right = (
        on_ground(0.1 + sign * stagger, sign * width, sign * apart * 0.6, heel, apart)
        for sign in (1.0, -1.0)
    )
    feet = left, right
    pitch = float(rng.uniform(0.6, 1.95))
    yaw, roll = _normal(rng, 0.25, 0.6), _normal(rng, 0.15, 0.35)
    middle = np.mean([f.ankle for f in feet], axis=0)
    pose = WholePose(
        pelvis=(float(middle[0]) - 0.1, 0.0, float(middle[2]) + float(rng.uniform(0.22, 0.45))),
        hips=(0.4 * yaw, 0.4 * pitch, 0.3 * roll), chest=(yaw, pitch, roll), feet=feet,
        over=over_feet(feet),
    )  # fmt: skip
    return _looked(rng, _on_toes(centred(pose)), size)


def _on_toes(pose: WholePose) -> WholePose:
    """Heels raised as far as the ankles need it."""
    feet = list(pose.feet)
    R = figure_in(pose).rotations[0]
    for side, s in enumerate(("l_", "r_")):
        missing = -_pitch(R[INDEX[s + "calf"]].T @ R[INDEX[s + "foot"]]) - 0.8 * _ANKLE_UP
        if missing > 0.0:
            heel = feet[side].pitch + 1.5 * missing
            feet[side] = replace(feet[side], pitch=heel, bend=heel)
    if (feet[0], feet[1]) == pose.feet:
        return pose
    return centred(replace(pose, feet=(feet[0], feet[1]), over=over_feet((feet[0], feet[1]))))


def kneel(rng: Rng, size: float) -> WholePose:
    """Kneel on both knees or on one, upright or sitting back on the heels, toes tucked under."""
    one = rng.random() < 0.45
    forward = int(rng.integers(2)) if one else -1
    back = 0.0 if one else float(rng.choice([0.0, 1.0])) * float(rng.uniform(0.1, 0.75))
    lean = float(rng.uniform(-0.1, 0.2)) if one else -back
    heel = float(rng.uniform(1.08, 1.18))
    feet: list[Foot] = []
    hip = np.array([0.0, 0.0, KNEE_HEIGHT + figure.THIGH * np.cos(back)])
    for side, sign in enumerate((1.0, -1.0)):
        width = _HIP_Y + float(rng.uniform(-0.02, 0.09))
        if side == forward:
            ankle = hip + [figure.CALF - 0.02 + rng.uniform(-0.08, 0.08), sign * width, 0.0]
            foot = Foot((0, 0, 0), yaw=sign * 0.12, splay=0.12)
            feet.append(with_ankle_at(foot, np.array([*ankle[:2], figure.REST[-2, 2]])))
            continue
        knee = np.array([figure.THIGH * np.sin(back), sign * width, KNEE_HEIGHT])
        foot = on_ground(0.0, sign * width, sign * float(rng.uniform(-0.1, 0.25)), heel)
        height = float(foot.ankle[2]) - KNEE_HEIGHT
        ankle = knee + [-np.sqrt(figure.CALF**2 - height**2), 0.0, height]
        feet.append(with_ankle_at(foot, ankle))
    pitch = float(rng.triangular(-0.15, 0.2, 1.5)) * (0.5 + 0.5 * size)
    yaw, roll = _normal(rng, 0.3, 0.7) * size, _normal(rng, 0.17, 0.35) * size
    pose = WholePose(
        pelvis=(0.0, 0.0, float(hip[2]) - _HIP_Z),
        hips=(0.2 * yaw, 0.3 * pitch + 0.3 * max(-lean, 0.0), 0.15 * roll),
        chest=(yaw, pitch, roll), feet=(feet[0], feet[1]),
    )  # fmt: skip
    return _looked(rng, settled(pose), size)


def balance(rng: Rng, size: float) -> WholePose:
    """Stand on one foot, the other leg raised to the front, the side or the back: also kicks."""
    free = int(rng.integers(2))
    sign = 1.0 - 2.0 * free
    flexion = float(rng.uniform(-0.45, 1.75)) * (0.5 + 0.5 * size)
    aside = float(rng.uniform(-0.1, 0.6)) * (1.0 if flexion < 1.0 else 0.5)
    knee = float(rng.uniform(0.05, 2.1))
    lean = -0.25 * max(flexion - 0.5, 0.0) + 0.35 * max(-flexion, 0.0)
    pitch = float(np.clip(rng.normal(lean + 0.1, 0.2), -0.3, 0.9))
    yaw, roll = _normal(rng, 0.25, 0.6) * size, -sign * (0.25 * aside + _normal(rng, 0.1, 0.2))
    pelvis = np.array([0.0, 0.0, HIP_HEIGHT - float(rng.uniform(0.01, 0.12))])
    hips = turn(yaw=0.3 * yaw, pitch=0.35 * pitch, roll=0.5 * roll)
    thigh = (
        hips
        @ turn(yaw=sign * float(rng.uniform(-0.1, 0.4)))
        @ turn(pitch=-flexion, roll=sign * aside)
    )
    calf = thigh @ turn(pitch=knee)
    hip = pelvis + hips @ [0.0, sign * _HIP_Y, _HIP_Z]
    ankle = hip - figure.THIGH * thigh[:, 2] - figure.CALF * calf[:, 2]
    foot_R = calf @ turn(pitch=float(rng.uniform(-0.25, 0.7)))
    raised = _foot_of(
        foot_R, ankle, float(rng.uniform(0.0, 0.3)), _splay(hips, thigh, ankle - hip, sign)
    )
    feet = list(stood(0.095, 0.0, 0.13))
    feet[free] = raised
    pose = WholePose(
        pelvis=tuple(pelvis), hips=(0.3 * yaw, 0.35 * pitch, 0.5 * roll), chest=(yaw, pitch, roll),
        feet=(feet[0], feet[1]), over=over_feet((feet[0], feet[1]), 0.0 if free else 1.0),
    )  # fmt: skip
    return _looked(rng, centred(pose, lifted=free), size)


def _foot_of(R: np.ndarray, ankle: np.ndarray, bend: float, splay: float) -> Foot:
    """A foot turned like R: of the two ways to tell it, the one with less yaw and roll."""
    yaw = float(np.arctan2(R[1, 0], R[0, 0]))
    pitch = float(np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0])))
    roll = float(np.arctan2(R[2, 1], R[2, 2]))
    if abs(yaw) + abs(roll) > np.pi:
        yaw, pitch, roll = (_wrapped(yaw + np.pi), np.pi - pitch, _wrapped(roll + np.pi))
        pitch = _wrapped(pitch)
    return with_ankle_at(Foot((0, 0, 0), yaw, pitch, roll, bend, splay), ankle)


def _wrapped(angle: float) -> float:
    return float((angle + np.pi) % (2.0 * np.pi) - np.pi)


def _splay(hips: np.ndarray, thigh: np.ndarray, leg: np.ndarray, sign: float) -> float:
    """How far the knee of a leg points outward, as `Foot.splay` counts it."""
    from egocap_sim.motion.kinematics.limbs import shortest_arc

    way = leg / np.linalg.norm(leg)
    local = (shortest_arc(-hips[:, 2], way) @ hips).T @ thigh[:, 0]
    return float(sign * np.arctan2(local[1], local[0]))


def stride(rng: Rng, size: float) -> WholePose:
    """A long step or a lunge, the heel behind raised."""
    lead, long = int(rng.integers(2)), float(rng.uniform(0.25, 0.75))
    feet: list[Foot] = []
    for side, sign in enumerate((1.0, -1.0)):
        y = sign * float(rng.uniform(0.06, 0.14))
        if side == lead:
            feet.append(on_ground(0.14 + 0.5 * long, y, sign * 0.1, 0.0, 0.1))
        else:
            heel = float(np.clip(1.3 * long + rng.uniform(-0.1, 0.2), 0.1, 1.0))
            feet.append(on_ground(0.14 - 0.5 * long, y, sign * 0.15, heel, 0.1))
    down = 0.05 + 0.42 * long**2 + float(rng.uniform(0.0, 0.12))
    pitch = float(rng.triangular(-0.15, 0.1, 1.0)) * size
    yaw, roll = _normal(rng, 0.35, 0.7) * size, _normal(rng, 0.15, 0.3) * size
    pose = WholePose(
        pelvis=(0.0, 0.0, HIP_HEIGHT - down), hips=(0.3 * yaw, 0.35 * pitch, 0.2 * roll),
        chest=(yaw, pitch, roll), feet=(feet[0], feet[1]),
        over=over_feet((feet[0], feet[1]), 0.65 if lead else 0.35),
    )  # fmt: skip
    return _looked(rng, centred(pose), size)


def straddle(rng: Rng, size: float) -> WholePose:
    """Legs wide apart, as a player who guards stands: upright or low, on both or more on one."""
    half, turned = float(rng.uniform(0.25, 0.58)), float(rng.uniform(0.1, 0.75))
    share = float(np.clip(rng.normal(0.5, 0.2), 0.12, 0.88))  # of the weight, on the right foot
    feet = stood(half, _normal(rng, 0.1, 0.3), turned)
    aside = half * (1.0 + 0.8 * abs(2.0 * share - 1.0)) - _HIP_Y  # of the straighter leg
    leg = figure.THIGH + figure.CALF
    down = leg - float(np.sqrt(leg**2 - min(aside, 0.8 * leg) ** 2))
    down += 0.02 + float(rng.beta(1.0, 2.0)) * 0.3
    pitch = float(rng.triangular(-0.15, 0.3, 1.3)) * size
    yaw, roll = _normal(rng, 0.3, 0.6) * size, _normal(rng, 0.17, 0.35) * size
    pose = WholePose(
        pelvis=(-0.2 * down, 0.0, HIP_HEIGHT - down),
        hips=(0.3 * yaw, 0.4 * pitch, 0.3 * roll), chest=(yaw, pitch, roll), feet=feet,
        over=over_feet(feet, share),
    )  # fmt: skip
    return _looked(rng, centred(pose), size)


LEGS: dict[str, tuple[Callable[[Rng, float], WholePose], float]] = {
    "reach": (reach, 0.55), "bend": (bend, 0.07), "crouch": (crouch, 0.07), "kneel": (kneel, 0.10),
    "balance": (balance, 0.10), "stride": (stride, 0.05), "straddle": (straddle, 0.06),
}  # fmt: skip
"""Kinds of poses, and how often each is drawn."""

_KNEE = 2.65  # radians of flexion at most
_HIP = 2.2
_ANKLE_UP, _ANKLE_DOWN = 0.7, 1.0  # dorsal, under load, and plantar
_OFF_M = 0.02  # a foot or a knee may be off its place
_RAISED_M = 0.06  # a foot that does not stand is this high at least, toes and ankle


def possible(pose: WholePose) -> bool:
    """Whether legs keep their joints' limits, reach their feet and have no knee in the floor."""
    clip = figure_in(pose)
    p, R = clip.positions[0], clip.rotations[0]
    if np.abs(p[0] - pose.pelvis).max() > _OFF_M:
        return False  # lowered: the legs are too short
    for side, s in enumerate(("l_", "r_")):
        thigh, calf, foot = (INDEX[s + part] for part in ("thigh", "calf", "foot"))
        if np.linalg.norm(p[foot] - pose.feet[side].ankle) > _OFF_M:
            return False
        if p[calf, 2] < KNEE_HEIGHT - _OFF_M or p[foot, 2] < 0.05:
            return False
        toe = pose.feet[side].toe[2]
        if abs(toe - TOE_HEIGHT) > 1e-6 and min(toe, p[foot, 2] - 0.04) < _RAISED_M:
            return False
        if _pitch(R[thigh].T @ R[calf]) > _KNEE or -_pitch(R[INDEX["pelvis"]].T @ R[thigh]) > _HIP:
            return False
        if not -_ANKLE_UP <= _pitch(R[calf].T @ R[foot]) <= _ANKLE_DOWN:
            return False
    knees = np.linalg.norm(p[INDEX["l_calf"]] - p[INDEX["r_calf"]])
    ankles = np.linalg.norm(p[INDEX["l_foot"]] - p[INDEX["r_foot"]])
    return bool(min(knees, ankles) > 0.11)


def _pitch(R: np.ndarray) -> float:
    return float(np.arctan2(R[0, 2], R[2, 2]))
