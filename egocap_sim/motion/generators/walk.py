"""A walk along a curved path inside a circle, without foot sliding.

Step length and rate follow the speed with a constant walk ratio (0.39 m per step/s), the
self-selected one. Source: N. Sekiya et al., Optimal walking in terms of variability in step
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
    """Radius in metres of the circle around the origin that the path stays in."""
    wander: Annotated[float, (0.0, 2.0)] = 1.0
    """Factor on the random bends of the path; 0 is straight until the edge."""
    arm_swing: Annotated[float, (0.0, 2.0)] = 1.0
    """Factor on the swing of the arms."""
    bounce: Annotated[float, (0.0, 2.0)] = 1.0
    """Factor on the rise and fall of the hips."""
    lean: Annotated[float, (-0.2, 0.4)] = 0.03
    """Radians the trunk leans forward."""
    stops: bool = True
    """Start and end standing, instead of walking throughout."""


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
    """Controls of a walk along a course; only the gait style of `params` is used."""
    first = int(rng.integers(2))
    narrow = rng.uniform(0.08, 0.13)

    def width(time: float) -> float:
        return 2.0 * HALF_WIDTH + (narrow - 2.0 * HALF_WIDTH) * float(course.amplitude(time))

    feet = plan_steps(course, width, first)
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
    look = course.at(t + 0.3)[1]  # the heading a little later
    nod = style.gaze_down + 0.03 * slow_noise(t, rng, 0.05, 0.3)
    trunk = (
        turn(yaw=heading + yaw, pitch=0.02 * gait, roll=-0.05 * gait * stance_side),
        turn(
            yaw=heading - 0.7 * yaw,
            pitch=style.slouch + params.lean * gait + 0.012 * gait * np.cos(2.0 * phase + 0.6),
            roll=0.015 * gait * stance_side,
        ),
        turn(
            yaw=look + 0.06 * slow_noise(t, rng, 0.05, 0.25),
            pitch=nod + 0.012 * gait * np.cos(2.0 * phase + 2.6),
        ),
    )
    return gait_controls(pelvis, trunk, roll_feet(t, feet, course.step_s), arm, flex)


def gait_controls(
    pelvis: Float[Array, "T 3"],
    trunk: tuple[Array, Array, Array],
    feet: tuple[Array, Array, Array],
    wrist: Float[Array, "T 2 3"],
    elbow: Float[Array, "T 2"],
) -> Controls:
    """Controls of a gait, from rotations of pelvis, chest and head, the feet of `roll_feet`, and
    the wrists and the elbow flexion [rad] of `swinging_arms`."""
    pelvis_R, chest_R, head_R = trunk
    ankle, foot_R, toe = feet
    return Controls(
        pelvis=pelvis,
        pelvis_R=pelvis_R,
        chest_R=chest_R,
        head_R=head_R,
        ankle=ankle,
        foot_R=foot_R,
        toe=toe,
        wrist=wrist,
        pronation=np.full(elbow.shape, HANG_PRONATION) + 0.15 * elbow,
        wrist_bend=np.zeros(elbow.shape),
        swivel=np.zeros(elbow.shape),
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
