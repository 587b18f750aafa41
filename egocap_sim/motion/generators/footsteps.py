"""Footstep plan of a walk, and the roll of each foot from heel over sole to ball.

Each stance keeps a part of the sole exactly still: the heel at the strike, then the whole sole,
then the toes while the heel lifts. Between stances the ankle follows a smooth curve that matches
the velocities of the stances at both ends.

Source: timing and foot angles after J. Perry, Gait Analysis (1992): stance is 62 % of a cycle, foot
flat from 8 % to 35 %; foot angle about 20 degrees at heel strike and 60 at toe-off in a full step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.motion.generators.course import Course
from egocap_sim.motion.generators.stance import TOE_OUT
from egocap_sim.motion.kinematics import figure
from egocap_sim.motion.kinematics.curves import minimum_jerk, turn, wrap_angle

STANCE = 1.24  # of a step's duration (two steps a cycle)
FLAT_FROM, FLAT_TO = 0.16, 0.70  # of a step's duration after the strike
STRIKE_PITCH, LIFT_PITCH = 0.33, 1.1  # radians at full step: toes up; heel up
FULL_STEP = 0.72  # metres between successive feet
MIDSTANCE = 0.50  # of a step's duration after the strike: the hip is above the ankle
TOE_CLEARANCE = 0.022  # metres, of the swinging toe over the ground

TOE_JOINT = figure.offset("l_toe", "l_foot") * [1.0, 0.0, 1.0]
"""Where the foot bends, in its own frame; the toes lie still while the heel lifts."""


@dataclass(frozen=True)
class Plant:
    """One stance of a foot."""

    strike: float  # seconds; -inf for a foot that stood from the start
    off: float  # seconds; +inf for one that stands to the end
    place: tuple[float, float]  # ankle's place on the floor while the foot is flat
    yaw: float
    strike_pitch: float  # radians, toes up
    lift_pitch: float  # radians, heel up
    height: float = 0.0  # metres of the ground under the foot


GroundAt = Callable[[Array], Array]
"""Height of the ground (T,) at places (T, 2), metres."""


def plan_steps(
    course: Course, width: Callable[[float], float], side: int
) -> tuple[list[Plant], list[Plant]]:
    """Stances of the left and the right foot for the steps of a walk along a course.

    `width` is the distance between the feet at a time, `side` the foot that steps first (0 left). A
    walk begins and ends with both feet side by side.
    """
    starts, step_s = course.starts, course.step_s
    feet: tuple[list[Plant], list[Plant]] = ([], [])
    strikes = np.arange(starts + step_s * 0.76, course.ends + 3.0 * step_s, step_s)
    spots: tuple[list, list] = ([(-np.inf, *_spot(course, width, starts, 0))],
                                [(-np.inf, *_spot(course, width, starts, 1))])  # fmt: skip
    for k, strike in enumerate(strikes):
        foot = (side + k) % 2
        place, yaw = _spot(course, width, strike + MIDSTANCE * step_s, foot)
        _, last, last_yaw = spots[foot][-1]
        if np.hypot(*np.subtract(place, last)) > 0.015 or abs(yaw - last_yaw) > 0.05:
            spots[foot].append((float(strike), place, yaw))
    swing = (2.0 - STANCE) * step_s
    for foot in (0, 1):
        stops = [s[0] - swing for s in spots[foot][1:]] + [np.inf]
        for n, ((strike, place, yaw), off) in enumerate(zip(spots[foot], stops, strict=True)):
            stride = [
                np.hypot(*np.subtract(place, spots[foot][m][1])) / (2.0 * FULL_STEP)
                if 0 <= m < len(spots[foot]) else 0.0
                for m in (n - 1, n + 1)
            ]  # fmt: skip
            feet[foot].append(
                Plant(strike, off, place, yaw, STRIKE_PITCH * min(stride[0], 1.15),
                      LIFT_PITCH * min(stride[1], 1.1) ** 0.7)
            )  # fmt: skip
    return feet


def _spot(
    course: Course, width: Callable[[float], float], time: float, foot: int
) -> tuple[tuple[float, float], float]:
    at, heading = course.at(np.array([time]))
    sign = 1.0 - 2.0 * foot
    left = np.array([-np.sin(heading[0]), np.cos(heading[0])])
    place = at[0] + sign * 0.5 * width(time) * left
    return (float(place[0]), float(place[1])), float(heading[0] + sign * TOE_OUT)


def roll_feet(
    t: Float[Array, "T"],
    feet: tuple[list[Plant], list[Plant]],
    step_s: float,
    ground: GroundAt | None = None,
) -> tuple[Float[Array, "T 2 3"], Float[Array, "T 2 3 3"], Float[Array, "T 2"]]:
    """Ankle positions, foot rotations and toe angles of both feet.

    Over uneven `ground` a swinging foot rises before it moves ahead, and moves ahead before it
    descends, so that it clears the edges.
    """
    curves = zip(*(_roll_foot(t, plants, step_s, ground) for plants in feet), strict=True)
    ankle, R, toe = (np.stack(curve, 1) for curve in curves)
    return ankle, R, toe


def _roll_foot(
    t: Array, plants: list[Plant], step_s: float, ground: GroundAt | None
) -> tuple[Float[Array, "T 3"], Float[Array, "T 3 3"], Float[Array, "T"]]:
    ankle, yaw, pitch = np.empty((len(t), 3)), np.empty(len(t)), np.empty(len(t))
    toe = np.zeros(len(t))
    for n, plant in enumerate(plants):
        on = (t >= plant.strike) & (t < plant.off)
        ankle[on], pitch[on] = _standing(t[on], plant, step_s)
        yaw[on], toe[on] = plant.yaw, np.maximum(pitch[on], 0.0)
        if n + 1 < len(plants):
            swing = (t >= plant.off) & (t < plants[n + 1].strike)
            ankle[swing], pitch[swing], yaw[swing], toe[swing] = _swinging(
                t[swing], plant, plants[n + 1], step_s, ground
            )
    return ankle, turn(yaw=yaw, pitch=pitch), toe


def _stance_pitch(t: Array, plant: Plant, step_s: float) -> Array:
    """Foot pitch, positive with the heel up."""
    pitch = np.zeros(len(t))
    if np.isfinite(plant.strike):
        s = (t - plant.strike) / (FLAT_FROM * step_s)
        pitch -= plant.strike_pitch * (1.0 - np.clip(s, 0.0, 1.0)) ** 2
    if np.isfinite(plant.off):
        s = (t - (plant.off - (STANCE - FLAT_TO) * step_s)) / ((STANCE - FLAT_TO) * step_s)
        s = np.clip(s, 0.0, 1.0)
        pitch += plant.lift_pitch * s * s * (2.2 - 1.2 * s)
    return pitch


def _standing(t: Array, plant: Plant, step_s: float) -> tuple[Array, Array]:
    """Ankle and pitch of a foot that rolls over its heel or its toe joint."""
    pitch = _stance_pitch(t, plant, step_s)
    flat = np.array([*plant.place, plant.height - figure.SOLE_HEEL[2]])
    R0, R = turn(yaw=plant.yaw), turn(yaw=plant.yaw, pitch=pitch)
    pivot = np.where((pitch > 0.0)[:, None], TOE_JOINT, figure.SOLE_HEEL)
    return flat + pivot @ R0.T - np.einsum("tij,tj->ti", R, pivot), pitch


def _swinging(
    t: Array, before: Plant, after: Plant, step_s: float, ground: GroundAt | None
) -> tuple[Array, Array, Array, Array]:
    """Ankle, pitch, yaw and toe angle between two stances."""
    h, T = 1e-4, after.strike - before.off
    s = (t - before.off) / T
    times = before.off - np.array([h, 0.0]), after.strike + np.array([0.0, h])
    (a, pa), (b, pb) = _standing(times[0], before, step_s), _standing(times[1], after, step_s)
    ankle = _hermite(s[:, None], a[1], b[0], (a[1] - a[0]) / h * T, (b[1] - b[0]) / h * T)
    pitch = _hermite(s, pa[1], pb[0], (pa[1] - pa[0]) / h * T, (pb[1] - pb[0]) / h * T)
    if (climb := after.height - before.height) != 0.0:
        ahead = minimum_jerk((s - 0.15) / 0.85 if climb > 0 else s / 0.85)
        up = minimum_jerk(s / 0.75 if climb > 0 else (s - 0.2) / 0.8)
        ankle = a[1] + np.stack([ahead, ahead, up], -1) * (b[0] - a[1])
        pitch = pa[1] * (1.0 - minimum_jerk(s / 0.4)) + pb[0] * minimum_jerk(2.0 * s - 1.0)
    yaw = before.yaw + minimum_jerk(s) * wrap_angle(after.yaw - before.yaw)
    toe = np.maximum(pitch, 0.0) * (1.0 if climb < 0 else 1.0 - minimum_jerk(s / 0.8))
    ankle[:, 2] += _lift(s, ankle, yaw, pitch, toe, ground)
    return ankle, pitch, yaw, toe


def _lift(
    s: Array, ankle: Array, yaw: Array, pitch: Array, toe: Array, ground: GroundAt | None
) -> Array:
    """Extra height so that heel, ball and toe tip clear the ground in the swing."""
    R = turn(yaw=yaw, pitch=pitch)
    tip = figure.offset("l_toe", "l_foot") + turn(pitch=-toe) @ figure.SOLE_TIP
    points = [R @ figure.SOLE_HEEL, R @ figure.SOLE_BALL, np.einsum("tij,tj->ti", R, tip)]
    below = [0.0 if ground is None else ground(ankle[:, :2] + p[:, :2]) for p in points]
    low = np.minimum.reduce([ankle[:, 2] + p[:, 2] - h for p, h in zip(points, below, strict=True)])
    hump = 4.0 * s * (1.0 - s)
    inside = hump > 0.02
    if not inside.any():
        return np.zeros(len(s))
    needed = (TOE_CLEARANCE * hump**2 - low)[inside] / hump[inside]
    return max(float(needed.max()), 0.0) * hump


def _hermite(s: Array, a: Array, b: Array, va: Array, vb: Array) -> Array:
    """Cubic from a to b over s in 0..1 with the speeds va and vb at its ends."""
    return (
        (2 * s**3 - 3 * s**2 + 1) * a + (s**3 - 2 * s**2 + s) * va
        + (-2 * s**3 + 3 * s**2) * b + (s**3 - s**2) * vb
    )  # fmt: skip
