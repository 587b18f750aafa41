"""Random poses of legs, trunk and head: one sampling function per kind of pose.

Each returns a pose with hanging arms and the feet or knees on the ground. Ranges are those of
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
    balance_on_feet,
    foot_on_ground,
    place_ankle,
    pose_clip,
    standing_feet,
    support_at_mass_centre,
    support_point,
)
from egocap_sim.motion.kinematics import figure
from egocap_sim.motion.kinematics.curves import turn, wrap_angle
from egocap_sim.motion.kinematics.limbs import bend_angle, shortest_arc

KNEE_HEIGHT = 0.075  # metres, of the knee joint while kneeling
_HIP_Y = float(figure.offset("l_thigh", "pelvis")[1])
_HIP_Z = float(figure.offset("l_thigh", "pelvis")[2])

Rng = np.random.Generator
Angles = tuple[float, float, float]
"""Yaw, pitch (forward) and roll, radians."""


def _normal(rng: Rng, spread: float, most: float) -> float:
    return float(np.clip(rng.normal(0.0, spread), -most, most))


def _add_gaze(rng: Rng, pose: WholePose, size: float) -> WholePose:
    """Add a random head orientation relative to the chest, more often down than up."""
    yaw = _normal(rng, 0.55, 1.2) * size
    pitch = float(rng.triangular(-0.7, 0.3, 0.75)) * size
    tilt = _normal(rng, 0.2, 0.5) * size
    return replace(pose, look=(yaw, pitch, tilt))


def _balanced_pose(
    pelvis: tuple[float, float, float],
    chest: Angles,
    follow: tuple[float, float, float],
    feet: tuple[Foot, Foot],
    share: float = 0.5,
    lifted: int | None = None,
) -> WholePose:
    """A pose whose centre of mass is above its feet.

    `follow` are the fractions of the chest's yaw, pitch and roll that the pelvis takes, `share` the
    fraction of the weight on the right foot, `lifted` the index of a raised foot.
    """
    yaw, pitch, roll = chest
    hips = (follow[0] * yaw, follow[1] * pitch, follow[2] * roll)
    support = support_point(feet, share)
    pose = WholePose(pelvis=pelvis, hips=hips, chest=chest, feet=feet, support=support)
    return balance_on_feet(pose, lifted)


def reach(rng: Rng, size: float) -> WholePose:
    """Stand with the legs bent and apart to a random degree, the trunk turned and bent."""
    feet = standing_feet(
        float(rng.uniform(0.07, 0.24)), _normal(rng, 0.1, 0.25), float(rng.uniform(0.0, 0.4))
    )
    down = float(rng.beta(1.0, 2.5)) * 0.36 * size
    yaw, roll = _normal(rng, 0.3, 0.6) * size, _normal(rng, 0.17, 0.35) * size
    pitch = float(rng.triangular(-0.25, 0.05, 0.9)) * size
    pelvis = (-0.3 * down, 0.0, HIP_HEIGHT - down)
    share = float(rng.uniform(0.3, 0.7))
    pose = _balanced_pose(pelvis, (yaw, pitch, roll), (0.3, 0.45, 0.3), feet, share)
    return _add_gaze(rng, pose, size)


def bend(rng: Rng, size: float) -> WholePose:
    """Bend far forward over nearly straight or bent legs."""
    feet = standing_feet(
        float(rng.uniform(0.07, 0.3)), _normal(rng, 0.1, 0.3), float(rng.uniform(0.0, 0.3))
    )
    down = 0.02 + float(rng.beta(1.0, 1.5)) * 0.38
    pitch = float(rng.triangular(0.9, 2.1, 2.3)) * (0.6 + 0.4 * size)
    yaw, roll = _normal(rng, 0.25, 0.6), _normal(rng, 0.15, 0.35)
    pelvis, share = (-0.08, 0.0, HIP_HEIGHT - down), float(rng.uniform(0.35, 0.65))
    pose = _balanced_pose(pelvis, (yaw, pitch, roll), (0.4, 0.55, 0.3), feet, share)
    return _add_gaze(rng, pose, size)


def crouch(rng: Rng, size: float) -> WholePose:
    """Squat low, heels down or raised, knees together or apart."""
    width, heel = float(rng.uniform(0.07, 0.24)), float(rng.choice([0.0, rng.uniform(0.2, 0.9)]))
    apart = float(rng.uniform(0.05, 0.75))
    stagger = _normal(rng, 0.08, 0.2)
    left, right = (
        foot_on_ground(0.1 + sign * stagger, sign * width, sign * apart * 0.6, heel, apart)
        for sign in (1.0, -1.0)
    )
    pitch = float(rng.uniform(0.6, 1.95))
    yaw, roll = _normal(rng, 0.25, 0.6), _normal(rng, 0.15, 0.35)
    middle = np.mean([left.ankle, right.ankle], axis=0)
    pelvis = (float(middle[0]) - 0.1, 0.0, float(middle[2]) + float(rng.uniform(0.22, 0.45)))
    pose = _balanced_pose(pelvis, (yaw, pitch, roll), (0.4, 0.4, 0.3), (left, right))
    return _add_gaze(rng, _raise_heels(pose), size)


def _raise_heels(pose: WholePose) -> WholePose:
    """Raise the heels as far as the range of the ankles requires."""
    feet = list(pose.feet)
    R = pose_clip(pose).rotations[0]
    for side, s in enumerate(("l_", "r_")):
        missing = -float(bend_angle(R[INDEX[s + "calf"]], R[INDEX[s + "foot"]])) - 0.8 * _ANKLE_UP
        if missing > 0.0:
            heel = feet[side].pitch + 1.5 * missing
            feet[side] = replace(feet[side], pitch=heel, bend=heel)
    both = (feet[0], feet[1])
    if both == pose.feet:
        return pose
    return balance_on_feet(replace(pose, feet=both, support=support_point(both)))


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
            feet.append(place_ankle(foot, np.array([*ankle[:2], figure.REST[-2, 2]])))
            continue
        knee = np.array([figure.THIGH * np.sin(back), sign * width, KNEE_HEIGHT])
        foot = foot_on_ground(0.0, sign * width, sign * float(rng.uniform(-0.1, 0.25)), heel)
        height = float(foot.ankle[2]) - KNEE_HEIGHT
        ankle = knee + [-np.sqrt(figure.CALF**2 - height**2), 0.0, height]
        feet.append(place_ankle(foot, ankle))
    pitch = float(rng.triangular(-0.15, 0.2, 1.5)) * (0.5 + 0.5 * size)
    yaw, roll = _normal(rng, 0.3, 0.7) * size, _normal(rng, 0.17, 0.35) * size
    pose = WholePose(
        pelvis=(0.0, 0.0, float(hip[2]) - _HIP_Z),
        hips=(0.2 * yaw, 0.3 * pitch + 0.3 * max(-lean, 0.0), 0.15 * roll),
        chest=(yaw, pitch, roll), feet=(feet[0], feet[1]),
    )  # fmt: skip
    return _add_gaze(rng, support_at_mass_centre(pose), size)


def balance(rng: Rng, size: float) -> WholePose:
    """Stand on one foot, the other leg raised to the front, the side or the back."""
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
    raised = _foot_pose(
        foot_R, ankle, float(rng.uniform(0.0, 0.3)), _splay(hips, thigh, ankle - hip, sign)
    )
    left, right = standing_feet(0.095, 0.0, 0.13)
    feet = (left, raised) if free else (raised, right)
    pelvis = (float(pelvis[0]), float(pelvis[1]), float(pelvis[2]))
    trunk, share = (yaw, pitch, roll), 0.0 if free else 1.0
    pose = _balanced_pose(pelvis, trunk, (0.3, 0.35, 0.5), feet, share, lifted=free)
    return _add_gaze(rng, pose, size)


def _foot_pose(R: np.ndarray, ankle: np.ndarray, bend: float, splay: float) -> Foot:
    """A foot with rotation R; of its two Euler decompositions the one with less yaw and roll."""
    yaw = float(np.arctan2(R[1, 0], R[0, 0]))
    pitch = float(np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0])))
    roll = float(np.arctan2(R[2, 1], R[2, 2]))
    if abs(yaw) + abs(roll) > np.pi:
        yaw, pitch, roll = (wrap_angle(yaw + np.pi), np.pi - pitch, wrap_angle(roll + np.pi))
        pitch = wrap_angle(pitch)
    return place_ankle(Foot((0, 0, 0), yaw, pitch, roll, bend, splay), ankle)


def _splay(hips: np.ndarray, thigh: np.ndarray, leg: np.ndarray, sign: float) -> float:
    """The `Foot.splay` of a leg from hip to ankle."""
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
            feet.append(foot_on_ground(0.14 + 0.5 * long, y, sign * 0.1, 0.0, 0.1))
        else:
            heel = float(np.clip(1.3 * long + rng.uniform(-0.1, 0.2), 0.1, 1.0))
            feet.append(foot_on_ground(0.14 - 0.5 * long, y, sign * 0.15, heel, 0.1))
    down = 0.05 + 0.42 * long**2 + float(rng.uniform(0.0, 0.12))
    pitch = float(rng.triangular(-0.15, 0.1, 1.0)) * size
    yaw, roll = _normal(rng, 0.35, 0.7) * size, _normal(rng, 0.15, 0.3) * size
    pelvis, share = (0.0, 0.0, HIP_HEIGHT - down), 0.65 if lead else 0.35
    trunk = (yaw, pitch, roll)
    pose = _balanced_pose(pelvis, trunk, (0.3, 0.35, 0.2), (feet[0], feet[1]), share)
    return _add_gaze(rng, pose, size)


def straddle(rng: Rng, size: float) -> WholePose:
    """Stand upright or low with the legs wide apart, the weight shared at random."""
    half, turned = float(rng.uniform(0.25, 0.58)), float(rng.uniform(0.1, 0.75))
    share = float(np.clip(rng.normal(0.5, 0.2), 0.12, 0.88))  # of the weight, on the right foot
    feet = standing_feet(half, _normal(rng, 0.1, 0.3), turned)
    aside = half * (1.0 + 0.8 * abs(2.0 * share - 1.0)) - _HIP_Y  # of the straighter leg
    leg = figure.THIGH + figure.CALF
    down = leg - float(np.sqrt(leg**2 - min(aside, 0.8 * leg) ** 2))
    down += 0.02 + float(rng.beta(1.0, 2.0)) * 0.3
    pitch = float(rng.triangular(-0.15, 0.3, 1.3)) * size
    yaw, roll = _normal(rng, 0.3, 0.6) * size, _normal(rng, 0.17, 0.35) * size
    pelvis = (-0.2 * down, 0.0, HIP_HEIGHT - down)
    pose = _balanced_pose(pelvis, (yaw, pitch, roll), (0.3, 0.4, 0.3), feet, share)
    return _add_gaze(rng, pose, size)


LEGS: dict[str, tuple[Callable[[Rng, float], WholePose], float]] = {
    "reach": (reach, 0.55), "bend": (bend, 0.07), "crouch": (crouch, 0.07), "kneel": (kneel, 0.10),
    "balance": (balance, 0.10), "stride": (stride, 0.05), "straddle": (straddle, 0.06),
}  # fmt: skip
"""Sampling function and probability of each kind of pose."""

_KNEE = 2.65  # radians of flexion at most
_HIP = 2.2
_ANKLE_UP, _ANKLE_DOWN = 0.7, 1.0  # dorsal, under load, and plantar
_OFF_M = 0.02  # position tolerance of a foot or a knee
_RAISED_M = 0.06  # least height of toes and ankle of a raised foot


def is_feasible(pose: WholePose) -> bool:
    """Whether the legs respect the joint limits, reach their feet and keep clear of the floor."""
    clip = pose_clip(pose)
    p, R = clip.positions[0], clip.rotations[0]
    if np.abs(p[0] - pose.pelvis).max() > _OFF_M:
        return False  # the solver lowered the pelvis: the legs are too short
    for side, s in enumerate(("l_", "r_")):
        thigh, calf, foot = (INDEX[s + part] for part in ("thigh", "calf", "foot"))
        if np.linalg.norm(p[foot] - pose.feet[side].ankle) > _OFF_M:
            return False
        if p[calf, 2] < KNEE_HEIGHT - _OFF_M or p[foot, 2] < 0.05:
            return False
        toe = pose.feet[side].toe[2]
        if abs(toe - TOE_HEIGHT) > 1e-6 and min(toe, p[foot, 2] - 0.04) < _RAISED_M:
            return False
        knee, hip = bend_angle(R[thigh], R[calf]), -bend_angle(R[INDEX["pelvis"]], R[thigh])
        if knee > _KNEE or hip > _HIP:
            return False
        if not -_ANKLE_UP <= bend_angle(R[calf], R[foot]) <= _ANKLE_DOWN:
            return False
    knees = np.linalg.norm(p[INDEX["l_calf"]] - p[INDEX["r_calf"]])
    ankles = np.linalg.norm(p[INDEX["l_foot"]] - p[INDEX["r_foot"]])
    return bool(min(knees, ankles) > 0.11)
