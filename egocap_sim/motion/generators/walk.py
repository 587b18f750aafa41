"""A walk along a curved way that stays inside a circle, on feet that do not slide.

Step length and rate follow the speed with a constant walk ratio (0.39 m per step/s), as people
choose by themselves. Source: N. Sekiya et al., Optimal walking in terms of variability in step
length (JOSPT 26, 1997); D. Winter, Biomechanics and Motor Control of Human Gait (1991), for the
amplitudes of pelvis, trunk and arms.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float
from numba import njit
from numpy import ndarray as Array

from egocap_sim.motion.generators.footsteps import MIDSTANCE, plan, roll_feet
from egocap_sim.motion.generators.stance import (
    HALF_WIDTH,
    HANG_PRONATION,
    HIP_HEIGHT,
    Style,
    draw_style,
)
from egocap_sim.motion.kinematics import figure
from egocap_sim.motion.kinematics.clip import Clip
from egocap_sim.motion.kinematics.curves import minimum_jerk, slow_noise, turn
from egocap_sim.motion.kinematics.posing import SIDES, Controls, pose_figure

WALK_RATIO = 0.39  # metres of step a step/s
TIGHTEST = 0.75  # metres, radius of the tightest turn


@dataclass(frozen=True)
class WalkParams:
    """Style of a walk; the factors are 1 for an ordinary person."""

    speed: float = 1.15
    """Speed in m/s, 0.3 to 1.7."""
    radius: float = 1.7
    """Metres around the origin that the way stays in, 1 or more."""
    wander: float = 1.0
    """How much the way bends where it need not; 0 is straight until the edge."""
    arm_swing: float = 1.0
    """Factor on the swing of the arms."""
    bounce: float = 1.0
    """Factor on the rise and fall of the hips."""
    lean: float = 0.03
    """Radians the trunk leans forward."""
    stops: bool = True
    """Start from standing and end standing, instead of being under way throughout."""


def walk(t: Float[Array, "T"], rng: np.random.Generator, params: WalkParams, fps: float) -> Clip:
    """A walk for the times t [s]."""
    style = draw_style(rng)
    way = CirclingWay(float(t[-1]), rng, params)
    return pose_figure("walk", fps, walk_along(way, t, rng, params, style))


class Way(Protocol):
    """Where a walk goes: position and heading over time, and when it starts and ends."""

    starts: float  # seconds
    ends: float
    step_s: float

    def at(self, t: Array) -> tuple[Array, Array]: ...

    def amplitude(self, t: Array | float) -> Array: ...


def walk_along(
    way: Way, t: Float[Array, "T"], rng: np.random.Generator, params: WalkParams, style: Style
) -> Controls:
    """Controls of a walk along a way; of `params` only the style of the gait counts."""
    first = int(rng.integers(2))
    narrow = rng.uniform(0.08, 0.13)

    def width(time: float) -> float:
        return 2.0 * HALF_WIDTH + (narrow - 2.0 * HALF_WIDTH) * float(way.amplitude(time))

    feet = plan(way.at, width, way.starts, way.ends, way.step_s, first)
    rolled = [roll_feet(t, plants, way.step_s) for plants in feet]
    gait = way.amplitude(t)
    # +1 when the left foot strikes, -1 when the right does.
    swing = np.cos(np.pi * (t - way.starts - 0.76 * way.step_s) / way.step_s + np.pi * first)
    phase = np.pi * (t - way.starts - (0.76 + MIDSTANCE) * way.step_s) / way.step_s
    stance_side = np.cos(phase + np.pi * first)  # +1 over the left foot
    xy, heading = way.at(t)
    left = np.stack([-np.sin(heading), np.cos(heading)], -1)
    length = way.step_s * params.speed
    dip = 0.5 * params.bounce * 0.045 * (length / 0.7) ** 2 * gait
    pelvis = np.empty((len(t), 3))
    pelvis[:, :2] = xy + (0.02 * gait * stance_side)[:, None] * left
    pelvis[:, 2] = HIP_HEIGHT - 0.014 * gait - 0.35 * dip + dip * (np.cos(2.0 * phase) - 1.0) * 0.5
    arm, flex = swinging_arms(t, swing * gait, gait, params, rng)
    yaw = -0.09 * gait * swing
    look = heading_ahead(way, t, 0.3)
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


def heading_ahead(way: Way, t: Float[Array, "T"], seconds: float) -> Float[Array, "T"]:
    """Where someone looks who walks: the way they will face a little later."""
    return way.at(t + seconds)[1]


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


class CirclingWay:
    """Position and heading over time of a body that walks inside a circle."""

    def __init__(self, seconds: float, rng: np.random.Generator, params: WalkParams) -> None:
        self.step_s = float(np.sqrt(WALK_RATIO / params.speed))
        ramp = 2.0 * self.step_s
        self.starts = float(rng.uniform(0.25, 0.5)) if params.stops else -2.3 * self.step_s
        self.ends = (
            max(seconds - 3.3 * self.step_s, self.starts) if params.stops else seconds + self.step_s
        )
        dt = 1.0 / 240.0
        self._t = np.arange(-4.0, seconds + 6.0, dt)
        up = minimum_jerk((self._t - self.starts) / ramp)
        down = (
            1.0 - minimum_jerk((self._t - self.ends + 0.3 * self.step_s) / ramp)
            if params.stops
            else 1.0
        )
        self._gait = up * down if params.stops else np.ones(len(self._t))
        self._speed = params.speed * self._gait
        self._integrate(dt, rng, params)

    def _integrate(self, dt: float, rng: np.random.Generator, params: WalkParams) -> None:
        start = rng.uniform(-0.4, 0.4)
        heading = start + rng.uniform(-0.3, 0.3)
        noise = 0.45 * params.wander * slow_noise(self._t, rng, 0.05, 0.22)
        far = 0.75 * params.radius
        self._xy, self._heading = _wandered(
            -far * np.cos(start), -far * np.sin(start), heading, self._speed * dt, noise,
            params.radius,
        )  # fmt: skip

    def at(self, t: Array) -> tuple[Array, Array]:
        xy = np.stack([np.interp(t, self._t, self._xy[:, a]) for a in (0, 1)], -1)
        return xy, np.interp(t, self._t, self._heading)

    def amplitude(self, t: Array | float) -> Array:
        """How much of a full gait there is, 0 standing to 1."""
        return np.asarray(np.interp(t, self._t, self._gait))


@njit(cache=True)
def _wandered(
    x: float,
    y: float,
    heading: float,
    steps: Float[Array, "T"],
    noise: Float[Array, "T"],
    radius: float,
) -> tuple[Float[Array, "T 2"], Float[Array, "T"]]:
    """Positions and headings of one who takes steps [m] from a place, bending at random [1/m] but
    inward at the edge of the circle."""
    xy, headings = np.empty((len(steps), 2)), np.empty(len(steps))
    bend, side = 0.0, 1.0
    for k, step in enumerate(steps):
        xy[k, 0], xy[k, 1], headings[k] = x, y, heading
        ahead_x, ahead_y = np.cos(heading), np.sin(heading)
        cross = ahead_y * x - ahead_x * y  # > 0: the middle is on the left
        if abs(cross) > 0.1:
            side = np.sign(cross)
        out = np.hypot(x + 0.8 * ahead_x, y + 0.8 * ahead_y) - 0.5 * radius
        inward = min(max(out / (0.4 * radius), 0.0), 1.0)
        if x * ahead_x + y * ahead_y < 0.0 and np.hypot(x, y) > 0.5 * radius:
            inward *= 0.5
        wanted = (1.0 - inward) * noise[k] + inward * side / TIGHTEST
        bend += (wanted - bend) * min(1.0, step / 0.25)
        bend = min(max(bend, -1.0 / TIGHTEST), 1.0 / TIGHTEST)
        heading += bend * step
        x, y = x + step * ahead_x, y + step * ahead_y
    return xy, headings
