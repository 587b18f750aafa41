"""Dribbling a ball: when which hand catches and pushes it, and the motion of doing so, walking."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.motion.generators.stance import draw_style
from egocap_sim.motion.generators.walk import CirclingWay, WalkParams, walk_along
from egocap_sim.motion.kinematics.clip import Clip
from egocap_sim.motion.kinematics.curves import hermite, minimum_jerk, turn
from egocap_sim.motion.kinematics.posing import aim_wrists, pose_figure

PUSH_S = 0.22  # seconds the hand stays with the ball
FLIGHT_S = 0.40  # from the hand to the floor and back
CAUGHT, PUSHED = 0.89, 0.82  # metres of the palm over the floor
RISING, PUSHING = 0.8, -2.1  # m/s of the palm at catch and push
_READY_S = 0.4  # before the first and after the last touch the hand is at the ball


@dataclass(frozen=True)
class DribbleParams:
    """Dribbling while walking about."""

    speed: float = 0.9
    """Speed in m/s, 0.3 to 1.7."""
    radius: float = 1.7
    """Metres around the origin that the way stays in, 1 or more."""
    crossover: float = 0.2
    """Share of the dribbles that change hands, 0 to 1."""


@dataclass(frozen=True)
class Touch:
    """The ball in one hand, from the catch to the push."""

    caught: float  # seconds
    pushed: float
    hand: int  # 0 left, 1 right


def touches(rng: np.random.Generator, params: DribbleParams, seconds: float) -> list[Touch]:
    """The touches a generator gives, from before the start to beyond the end; `dribble`'s own."""
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
    """Dribble for the times t [s], crouching a little, now and then from hand to hand."""
    played = touches(rng, params, float(t[-1]))
    style = draw_style(rng)
    walk = WalkParams(speed=params.speed, radius=params.radius, arm_swing=0.6, stops=False)
    way = CirclingWay(float(t[-1]), rng, walk)
    controls = walk_along(way, t, rng, walk, style)
    crouch, lean = rng.uniform(0.05, 0.09), rng.uniform(0.18, 0.28)
    xy, heading = way.at(t)
    level = turn(yaw=heading)
    controls = dataclasses.replace(
        controls,
        pelvis=controls.pelvis - [0.0, 0.0, crouch],
        chest_R=level @ turn(pitch=lean) @ np.swapaxes(level, -1, -2) @ controls.chest_R,
        head_R=level @ turn(pitch=0.15) @ np.swapaxes(level, -1, -2) @ controls.head_R,
    )
    wrist, share = np.empty((len(t), 2, 3)), np.empty((len(t), 2))
    for hand in (0, 1):
        local, share[:, hand] = _palm(t, [k for k in played if k.hand == hand], hand)
        world = np.einsum("tij,tj->ti", level, local - [0.07, 0.0, -0.045])
        wrist[:, hand] = world + np.pad(xy, ((0, 0), (0, 1)))
    controls = aim_wrists(controls, wrist, share)
    controls.pronation[:] += share * (1.35 - controls.pronation)
    controls.wrist_bend[:] += share * 0.35
    return pose_figure("dribble", fps, controls)


def _palm(
    t: Float[Array, "T"], mine: list[Touch], hand: int
) -> tuple[Float[Array, "T 3"], Float[Array, "T"]]:
    """The palm in a frame that walks along, and how much it is with the ball."""
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
