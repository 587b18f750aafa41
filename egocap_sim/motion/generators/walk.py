"""A walk along a curved way that stays inside a circle, on feet that do not slide.

Step length and rate follow the speed with a constant walk ratio (0.39 m per step/s), as people
choose by themselves. Source: N. Sekiya et al., Optimal walking in terms of variability in step
length (JOSPT 26, 1997); D. Winter, Biomechanics and Motor Control of Human Gait (1991), for the
amplitudes of pelvis, trunk and arms.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.motion.generators.course import Course, circling_course
from egocap_sim.motion.generators.footsteps import MIDSTANCE, plan_steps, roll_feet
from egocap_sim.motion.generators.stance import (
    HALF_WIDTH,
    HANG_PRONATION,
    HIP_HEIGHT,
    Style,
    draw_style,
)
from egocap_sim.motion.kinematics import figure
from egocap_sim.motion.kinematics.clip import Clip
from egocap_sim.motion.kinematics.curves import slow_noise, turn
from egocap_sim.motion.kinematics.posing import SIDES, Controls, pose_figure


@dataclass(frozen=True)
class WalkParams:
    """Style of a walk; the factors are 1 for an ordinary person."""

    speed: Annotated[float, (0.3, 1.7)] = 1.15
    """Speed in m/s."""
    radius: Annotated[float, (1.0, 100.0)] = 1.7
    """Metres around the origin that the way stays in."""
    wander: Annotated[float, (0.0, 2.0)] = 1.0
    """How much the way bends where it need not; 0 is straight until the edge."""
    arm_swing: Annotated[float, (0.0, 2.0)] = 1.0
    """Factor on the swing of the arms."""
    bounce: Annotated[float, (0.0, 2.0)] = 1.0
    """Factor on the rise and fall of the hips."""
    lean: Annotated[float, (-0.2, 0.4)] = 0.03
    """Radians the trunk leans forward."""
    stops: bool = True
    """Start from standing and end standing, instead of being under way throughout."""


def walk(t: Float[Array, "T"], rng: np.random.Generator, params: WalkParams, fps: float) -> Clip:
    """A walk for the times t [s]."""
    style = draw_style(rng)
    course = circling_course(
        float(t[-1]), rng, params.speed, params.radius, params.wander, params.stops
    )
    return pose_figure("walk", fps, walk_along(course, t, rng, params, style))


def walk_along(
    course: Course, t: Float[Array, "T"], rng: np.random.Generator, params: WalkParams, style: Style
) -> Controls:
    """Controls of a walk along a course; of `params` only the style of the gait counts."""
    first = int(rng.integers(2))
    narrow = rng.uniform(0.08, 0.13)

    def width(time: float) -> float:
        return 2.0 * HALF_WIDTH + (narrow - 2.0 * HALF_WIDTH) * float(course.amplitude(time))

    feet = plan_steps(course, width, first)
    rolled = [roll_feet(t, plants, course.step_s) for plants in feet]
    gait = course.amplitude(t)
    # +1 when the left foot strikes, -1 when the right does.
    swing = np.cos(
        np.pi * (t - course.starts - 0.76 * course.step_s) / course.step_s + np.pi * first
    )
    phase = np.pi * (t - course.starts - (0.76 + MIDSTANCE) * course.step_s) / course.step_s
    stance_side = np.cos(phase + np.pi * first)  # +1 over the left foot
    xy, heading = course.at(t)
    left = np.stack([-np.sin(heading), np.cos(heading)], -1)
    length = course.step_s * params.speed
    dip = 0.5 * params.bounce * 0.045 * (length / 0.7) ** 2 * gait
    pelvis = np.empty((len(t), 3))
    pelvis[:, :2] = xy + (0.02 * gait * stance_side)[:, None] * left
    pelvis[:, 2] = HIP_HEIGHT - 0.014 * gait - 0.35 * dip + dip * (np.cos(2.0 * phase) - 1.0) * 0.5
    arm, flex = swinging_arms(t, swing * gait, gait, params, rng)
    yaw = -0.09 * gait * swing
    look = course.at(t + 0.3)[1]  # towards where they will face
    nod = style.gaze_down + 0.03 * slow_noise(t, rng, 0.05, 0.3)
    return Controls(
        pelvis=pelvis,
        pelvis_R=turn(yaw=heading + yaw, pitch=0.02 * gait, roll=-0.05 * gait * stance_side),
        chest_R=turn(
            yaw=heading - 0.7 * yaw,
            pitch=style.slouch + params.lean * gait + 0.012 * gait * np.cos(2.0 * phase + 0.6),
            roll=0.015 * gait * stance_side,
        ),
        head_R=turn(
            yaw=look + 0.06 * slow_noise(t, rng, 0.05, 0.25),
            pitch=nod + 0.012 * gait * np.cos(2.0 * phase + 2.6),
        ),
        ankle=np.stack([r[0] for r in rolled], 1),
        foot_R=np.stack([r[1] for r in rolled], 1),
        toe=np.stack([r[2] for r in rolled], 1),
        wrist=arm,
        pronation=np.full((len(t), 2), HANG_PRONATION) + 0.15 * flex,
        wrist_bend=np.zeros((len(t), 2)),
        swivel=np.zeros((len(t), 2)),
    )


def swinging_arms(
    t: Array, swing: Array, gait: Array, params: WalkParams, rng: np.random.Generator
) -> tuple[Float[Array, "T 2 3"], Float[Array, "T 2"]]:
    """Wrists, and flexion, from shoulder and elbow angles: each arm swings with the other leg."""
    wrist, flex = np.empty((len(t), 2, 3)), np.empty((len(t), 2))
    reach = params.arm_swing * (0.14 + 0.22 * params.speed) * rng.uniform(0.8, 1.15)
    for i, (_, sign) in enumerate(SIDES):
        shoulder = 0.03 + reach * rng.uniform(0.85, 1.15) * (-sign * swing + 0.15 * gait)
        elbow = 0.22 + 0.16 * gait + 0.35 * reach * (-sign * swing + gait)
        out = 0.11 + 0.02 * gait
        upper = _down(shoulder) * figure.UPPERARM
        wrist[:, i] = upper + _down(shoulder + elbow) * figure.FOREARM
        wrist[:, i, 1] += (
            sign * np.tan(out) * -wrist[:, i, 2] - sign * 0.25 * (elbow - 0.22) * figure.FOREARM
        )
        flex[:, i] = elbow
    return wrist, flex


def _down(angle: Array) -> Float[Array, "T 3"]:
    """Unit vectors swung forward from straight down."""
    return np.stack([np.sin(angle), np.zeros(len(angle)), -np.cos(angle)], -1)
