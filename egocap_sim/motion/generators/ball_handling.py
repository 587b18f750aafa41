"""Dribbling a ball while walking and juggling three balls: motion and contact times.

Source: C. Shannon, Scientific aspects of juggling (1981): (flight + dwell) x hands = (vacant +
dwell) x balls, for the timing of a cascade.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.motion.generators.course import circling_course
from egocap_sim.motion.generators.stance import draw_style, standing
from egocap_sim.motion.generators.walk import WalkParams, walk_along
from egocap_sim.motion.kinematics.clip import Clip
from egocap_sim.motion.kinematics.curves import hermite, minimum_jerk, turn
from egocap_sim.motion.kinematics.posing import aim_wrists, pose_figure

PUSH_S = 0.22  # seconds of contact between hand and ball
FLIGHT_S = 0.40  # from the hand to the floor and back
CAUGHT, PUSHED = 0.89, 0.82  # metres of the palm over the floor
RISING, PUSHING = 0.8, -2.1  # m/s of the palm at catch and push
_READY_S = 0.4  # hand at the ball before the first and after the last touch
BALLS = 3
PALM = 0.085  # metres from the wrist to the middle of the palm


@dataclass(frozen=True)
class DribbleParams:
    """Dribbling while walking about."""

    speed: Annotated[float, (0.3, 1.7)] = 0.9
    """Speed in m/s."""
    radius: Annotated[float, (1.0, 100.0)] = 1.7
    """Radius in metres of the circle around the origin that the path stays in."""
    crossover: Annotated[float, (0.0, 1.0)] = 0.2
    """Fraction of dribbles that change hands."""


@dataclass(frozen=True)
class Touch:
    """One contact of hand and ball, from catch to push."""

    caught: float  # seconds
    pushed: float
    hand: int  # 0 left, 1 right


def plan_touches(rng: np.random.Generator, params: DribbleParams, seconds: float) -> list[Touch]:
    """Draw the touches of `dribble`, from before the start to beyond the end."""
    hand, clock = int(rng.random() < 0.8), -0.2
    found = []
    while clock < seconds + 2.0:
        found.append(Touch(clock, clock + PUSH_S, hand))
        clock += PUSH_S + FLIGHT_S
        hand = 1 - hand if rng.random() < params.crossover else hand
    return found


def dribble(
    t: Float[Array, "T"], rng: np.random.Generator, params: DribbleParams, fps: float
) -> Clip:
    """Dribble for the times t [s], crouching slightly, with occasional crossovers."""
    played = plan_touches(rng, params, float(t[-1]))
    style = draw_style(rng)
    walk = WalkParams(speed=params.speed, arm_swing=0.6)
    course = circling_course(float(t[-1]), rng, params.speed, params.radius)
    controls = walk_along(course, t, rng, walk, style)
    crouch, lean = rng.uniform(0.05, 0.09), rng.uniform(0.18, 0.28)
    xy, heading = course.at(t)
    level = turn(yaw=heading)
    controls = dataclasses.replace(
        controls,
        pelvis=controls.pelvis - [0.0, 0.0, crouch],
        chest_R=level @ turn(pitch=lean) @ np.swapaxes(level, -1, -2) @ controls.chest_R,
        head_R=level @ turn(pitch=0.15) @ np.swapaxes(level, -1, -2) @ controls.head_R,
    )
    wrist, share = np.empty((len(t), 2, 3)), np.empty((len(t), 2))
    for hand in (0, 1):
        local, share[:, hand] = _dribbling_palm(t, [k for k in played if k.hand == hand], hand)
        world = np.einsum("tij,tj->ti", level, local - [0.07, 0.0, -0.045])
        wrist[:, hand] = world + np.pad(xy, ((0, 0), (0, 1)))
    controls = aim_wrists(controls, wrist, share)
    controls.pronation[:] += share * (1.35 - controls.pronation)
    controls.wrist_bend[:] += share * 0.35
    return pose_figure("dribble", fps, controls)


def _dribbling_palm(
    t: Float[Array, "T"], mine: list[Touch], hand: int
) -> tuple[Float[Array, "T 3"], Float[Array, "T"]]:
    """The palm in the frame of the walk, and the weight 0..1 of that target."""
    side = 1.0 - 2.0 * hand
    top, low = np.array([0.40, 0.34 * side, CAUGHT]), np.array([0.42, 0.30 * side, PUSHED])
    up, down = np.array([0.0, 0.0, RISING]), np.array([0.0, 0.0, PUSHING])
    palm, share = np.tile(top, (len(t), 1)), np.zeros(len(t))
    for n, touch in enumerate(mine):
        on = (t >= touch.caught) & (t < touch.pushed)
        s = (t[on] - touch.caught) / PUSH_S
        palm[on] = hermite(s, top, low, up * PUSH_S, down * PUSH_S)
        following = mine[n + 1].caught if n + 1 < len(mine) else np.inf
        stays = following if following - touch.pushed < 2.0 * _READY_S else touch.pushed
        near = np.minimum(t - touch.caught + _READY_S, stays + _READY_S - t) / _READY_S
        share = np.maximum(share, minimum_jerk(near))
        gap = min(following - touch.pushed, 2.0 * FLIGHT_S)
        off = (t >= touch.pushed) & (t < touch.pushed + gap)
        s = (t[off] - touch.pushed) / gap
        palm[off] = hermite(s, low, top, 0.5 * down * gap, up * gap)
    return palm, share


@dataclass(frozen=True)
class JuggleParams:
    """A three-ball cascade."""

    flight: Annotated[float, (0.45, 0.8)] = 0.62
    """Seconds of flight; longer flights are higher."""
    dwell: Annotated[float, (0.2, 0.4)] = 0.30
    """Seconds a ball stays in a hand."""


@dataclass(frozen=True)
class Cascade:
    """Timing: throw n is at `first + n * beat` seconds, with hand n % 2 (0 left), of ball n % 3."""

    first: float
    flight: float
    dwell: float

    @property
    def beat(self) -> float:
        """Seconds between throws: half a hand's period."""
        return (self.flight + self.dwell) / BALLS


def plan_cascade(rng: np.random.Generator, params: JuggleParams) -> Cascade:
    """Draw the timing of `juggle`."""
    return Cascade(-float(rng.uniform(0.0, 1.0)), params.flight, params.dwell)


def juggle(
    t: Float[Array, "T"], rng: np.random.Generator, params: JuggleParams, fps: float
) -> Clip:
    """Juggle three balls, standing, for the times t [s], without start or end."""
    timing = plan_cascade(rng, params)
    style = draw_style(rng)
    controls = standing(t, style, rng)
    ahead, height = rng.uniform(0.34, 0.40), rng.uniform(0.98, 1.06)
    wrist = np.stack([_juggling_palm(t, timing, hand, ahead, height) for hand in (0, 1)], 1)
    controls = aim_wrists(controls, wrist - [PALM, 0.0, 0.0])
    controls.pronation[:] = -1.35
    controls.wrist_bend[:] = -0.1
    controls.head_R = turn(pitch=-0.12) @ controls.head_R  # gaze at the tops of the flights
    return pose_figure("juggle", fps, controls)


def _juggling_palm(
    t: Float[Array, "T"], timing: Cascade, hand: int, ahead: float, height: float
) -> Float[Array, "T 3"]:
    """Palm path: caught outside and falling, thrown inside and rising, back over the top."""
    side, period = 1.0 - 2.0 * hand, 2.0 * timing.beat
    caught = np.array([ahead, side * 0.27, height - 0.01])
    thrown = np.array([ahead, side * 0.12, height + 0.02])
    falling, rising = np.array([0.0, 0.0, -1.3]), np.array([0.0, 0.0, 2.1])
    since = (t - timing.first - hand * timing.beat) % period  # seconds after a throw
    vacant = period - timing.dwell
    back = hermite(since / vacant, thrown, caught, rising * vacant, falling * vacant)
    s = (since - vacant) / timing.dwell
    scoop = hermite(s, caught, thrown, falling * timing.dwell, rising * timing.dwell)
    return np.where((since < vacant)[:, None], back, scoop)
