"""Paths of walks: position, heading and gait amplitude over time; straight or in a circle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numba import njit
from numpy import ndarray as Array

from egocap.series import interpolate
from egocap_sim.motion.kinematics.curves import minimum_jerk, slow_noise

WALK_RATIO = 0.39  # metres of step a step/s
TIGHTEST = 0.75  # metres, radius of the tightest turn
BEFORE_S, AFTER_S = 4.0, 6.0  # extent of a course before and after the walk


@dataclass(frozen=True, eq=False)
class Course:
    """The path of a walk, sampled at increasing times [s]."""

    times: Float[Array, "N"]
    xy: Float[Array, "N 2"]
    heading: Float[Array, "N"]
    gait: Float[Array, "N"]  # amplitude: 0 standing, 1 a full gait
    speed: float  # m/s
    starts: float  # seconds
    ends: float

    @property
    def step_s(self) -> float:
        """Seconds from one step to the next."""
        return step_seconds(self.speed)

    def at(self, t: Array) -> tuple[Array, Array]:
        """Positions (T, 2) and headings (T,) at times."""
        xy = interpolate(t, self.times, self.xy)
        return xy, np.interp(t, self.times, self.heading)

    def amplitude(self, t: Array | float) -> Array:
        """Gait amplitude from 0 (standing) to 1 (full gait)."""
        return np.asarray(np.interp(t, self.times, self.gait))


def step_seconds(speed: float) -> float:
    """Seconds per step at a walking speed [m/s]."""
    return float(np.sqrt(WALK_RATIO / speed))


def course_times(seconds: float, fps: float = 60.0) -> Float[Array, "N"]:
    """Sample times of a course of that length."""
    return np.arange(-round(BEFORE_S * fps), round((seconds + AFTER_S) * fps) + 1) / fps


def straight_course(length_m: float, speed: float) -> tuple[Course, float]:
    """A course along x from the origin over `length_m`, standing at both ends, and its seconds."""
    step_s = step_seconds(speed)
    starts = 0.3
    ends = starts + max(length_m / speed, 2.0 * step_s)
    seconds = ends + 3.3 * step_s
    t = course_times(seconds)
    gait = _gait(t, starts, ends, step_s)
    x = np.concatenate([[0.0], np.cumsum(gait[:-1] * np.diff(t))]) * speed
    xy = np.stack([x * length_m / x[-1], np.zeros(len(t))], -1)
    return Course(t, xy, np.zeros(len(t)), gait, speed, starts, ends), seconds


def circling_course(
    seconds: float,
    rng: np.random.Generator,
    speed: float,
    radius: float,
    wander: float = 1.0,
    stops: bool = False,
) -> Course:
    """A winding path [m, m/s] inside a circle around the origin; see `walk.WalkParams`."""
    step_s, dt = step_seconds(speed), 1.0 / 240.0
    t = np.arange(-BEFORE_S, seconds + AFTER_S, dt)
    if stops:
        starts = float(rng.uniform(0.25, 0.5))
        ends = max(seconds - 3.3 * step_s, starts)
        gait = _gait(t, starts, ends, step_s)
    else:
        starts, ends, gait = -2.3 * step_s, seconds + step_s, np.ones(len(t))
    start = rng.uniform(-0.4, 0.4)
    heading = start + rng.uniform(-0.3, 0.3)
    noise = 0.45 * wander * slow_noise(t, rng, 0.05, 0.22)
    x, y = -0.75 * radius * np.cos(start), -0.75 * radius * np.sin(start)
    xy, headings = _wander(x, y, heading, speed * gait * dt, noise, radius)
    return Course(t, xy, headings, gait, speed, starts, ends)


def _gait(t: Array, starts: float, ends: float, step_s: float) -> Float[Array, "N"]:
    """Amplitude of a gait that begins and ends standing."""
    up = minimum_jerk((t - starts) / (2.0 * step_s))
    return up * (1.0 - minimum_jerk((t - ends + 0.3 * step_s) / (2.0 * step_s)))


@njit(cache=True)
def _wander(
    x: float,
    y: float,
    heading: float,
    steps: Float[Array, "T"],
    noise: Float[Array, "T"],
    radius: float,
) -> tuple[Float[Array, "T 2"], Float[Array, "T"]]:
    """Positions and headings after steps [m] with random curvature [1/m], bounded by a circle."""
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
