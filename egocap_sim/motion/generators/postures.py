"""Whole-body moves on planted feet: squat, sit down and stand up, look around, stand idle.

Source of the guided moves' neutral stance: Cooke and Wei 1988, natural head position is repeated
within 1.9 degrees before a mirror.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.motion.generators.keyframes import DOWN, Hand, Keyframes, PaceParams
from egocap_sim.motion.generators.stance import HIP_HEIGHT, draw_style
from egocap_sim.motion.kinematics.clip import Clip

SEAT_TO_PELVIS = 0.115  # metres from a seat to the pelvis joint while sitting
SIT_BACK_M = 0.40  # that the pelvis moves back to sit down


@dataclass(frozen=True)
class SquatParams(PaceParams):
    """Repeated squats."""

    depth: Annotated[float, (0.1, 1.0)] = 0.8
    """1: the thighs are level."""


def squat(t: Float[Array, "T"], rng: np.random.Generator, params: SquatParams, fps: float) -> Clip:
    """Squats with the arms stretched forward for balance, for the times t [s]."""
    keys = Keyframes(draw_style(rng), rng, params.pace)
    keys.wait(rng.uniform(0.3, 0.5))

    keys.repeat(
        lambda k: _squat_once(k, params.depth, rng), float(t[-1]), lambda: rng.uniform(0.3, 0.8)
    )
    return keys.clip("squat", t, fps)


def _squat_once(
    keys: Keyframes,
    depth: float,
    rng: np.random.Generator,
    gaze: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> None:
    """One squat; `gaze` is the head's yaw, pitch and roll after it."""
    depth = float(np.clip(depth * rng.uniform(0.9, 1.05), 0.1, 1.05))
    down, up = rng.uniform(1.1, 1.4) * keys.pace, rng.uniform(0.95, 1.2) * keys.pace
    keys.pelvis(-0.16 * depth, 0.0, -0.36 * depth, down)
    keys.trunk(0.0, 0.62 * depth, 0.0, down)
    keys.gaze(0.0, 0.12, down)
    keys.both_hands(Hand((0.50, 0.0, -0.10), 1.2), down)
    keys.wait(down + rng.uniform(0.1, 0.4))
    keys.pelvis(0.0, 0.0, 0.0, up)
    keys.trunk(0.0, 0.0, 0.0, up)
    keys.gaze(gaze[0], gaze[1], up, roll=gaze[2])
    keys.both_hands(DOWN, up)
    keys.wait(up)


@dataclass(frozen=True)
class SitParams(PaceParams):
    """Sitting down onto an implied seat and standing up again."""

    seat: Annotated[float, (0.35, 0.6)] = 0.46
    """Height of the seat in metres."""
    stay: Annotated[float, (0.0, 600.0)] = 1.5
    """Seconds of sitting."""


def sit(t: Float[Array, "T"], rng: np.random.Generator, params: SitParams, fps: float) -> Clip:
    """Sit down, stay and stand up, repeatedly, for the times t [s]."""
    keys = Keyframes(draw_style(rng), rng, params.pace)
    keys.wait(rng.uniform(0.3, 0.6))
    drop, back = params.seat + SEAT_TO_PELVIS - HIP_HEIGHT, -SIT_BACK_M
    lap = Hand((0.34, -0.01, -0.37), 1.1)

    def once(keys: Keyframes) -> None:
        down = rng.uniform(1.5, 1.8) * keys.pace
        keys.trunk(0.0, 0.62, 0.0, 0.6 * down)
        keys.pelvis(back, 0.0, drop, down)
        keys.gaze(0.0, 0.3, 0.5 * down)
        keys.both_hands(lap, down, later=0.05)
        keys.wait(0.72 * down)
        keys.trunk(0.0, 0.05, 0.0, 0.55 * down)
        keys.gaze(0.0, 0.0, 0.6)
        keys.wait(0.5 * down + params.stay * rng.uniform(0.8, 1.2))
        up = rng.uniform(1.5, 1.8) * keys.pace
        keys.trunk(0.0, 0.68, 0.0, 0.45 * up)
        keys.gaze(0.0, 0.2, 0.5)
        keys.wait(0.3 * up)
        keys.pelvis(0.0, 0.0, 0.0, 0.75 * up)
        keys.both_hands(DOWN, 0.7 * up)
        keys.wait(0.25 * up)
        keys.trunk(0.0, 0.0, 0.0, 0.6 * up)
        keys.gaze(0.0, 0.0, 0.5)
        keys.wait(0.65 * up)

    keys.repeat(once, float(t[-1]), lambda: rng.uniform(0.4, 0.9))
    return keys.clip("sit", t, fps, balance=False)


@dataclass(frozen=True)
class LookParams(PaceParams):
    """Looking around while standing."""

    yaw: Annotated[float, (0.1, 1.3)] = 1.1
    """Largest yaw of the head, radians."""


def look_around(
    t: Float[Array, "T"], rng: np.random.Generator, params: LookParams, fps: float
) -> Clip:
    """Turn the head, and partly the trunk, in random directions."""
    keys = Keyframes(draw_style(rng), rng, params.pace)
    keys.wait(rng.uniform(0.2, 0.5))
    side = rng.choice([-1.0, 1.0])

    def look(keys: Keyframes, yaw: float, pitch: float) -> None:
        seconds = (0.45 + 0.35 * abs(yaw)) * keys.pace
        keys.gaze(yaw, pitch, seconds / keys.pace)
        keys.trunk(0.3 * yaw, 0.0, 0.0, 1.2 * seconds)
        keys.wait(1.2 * seconds)

    home = 1.2 * (0.45 + 0.35 * params.yaw) * keys.pace
    while True:
        yaw, pitch = float(side * rng.uniform(0.25, 1.0) * params.yaw), rng.uniform(-0.3, 0.4)
        if not keys.perform([lambda s, y=yaw, p=pitch: look(s, y, p)], float(t[-1]) - home):
            break
        keys.wait(rng.uniform(0.3, 1.2))
        side = -side if rng.random() < 0.75 else side
    keys.clock = min(keys.clock, max(float(t[-1]) - home - 0.15, 0.0))
    look(keys, 0.0, 0.0)
    return keys.clip("look_around", t, fps)


@dataclass(frozen=True)
class IdleParams:
    """Standing at ease."""


def idle(t: Float[Array, "T"], rng: np.random.Generator, params: IdleParams, fps: float) -> Clip:
    """Stand, breathe, shift weight."""
    return Keyframes(draw_style(rng), rng).clip("idle", t, fps)


@dataclass(frozen=True)
class GuidedParams(PaceParams):
    """The moves that `egocap fit-rig` asks for."""

    stand: Annotated[float, (0.5, 10.0)] = 1.5
    """Seconds of the neutral stance at the beginning."""


def guided(
    t: Float[Array, "T"], rng: np.random.Generator, params: GuidedParams, fps: float
) -> Clip:
    """Nod, turn and tilt the head, raise the arms, squat; look at a mark on the horizon between.

    The horizon is met with the error of natural head position, a new one each time. A move leaves
    its axis by as much.
    """
    style = replace(draw_style(rng), gaze_down=0.0, wander=LOOKING_AT_MARK)
    keys = Keyframes(style, rng, params.pace)
    keys.moved = True  # so that moves that would end too late are left out
    keys.begin_gaze(*_horizon(rng))
    keys.wait(params.stand)
    seconds = float(t[-1])
    for move in HEAD_MOVES:
        away = np.array(move) + NATURAL_HEAD * rng.standard_normal(3)
        keys.perform([lambda k, away=away: _turn_head(k, away, _horizon(rng))], seconds)
    keys.perform([_raise_arms], seconds)
    keys.repeat(lambda k: _squat_once(k, 0.8, rng, _horizon(rng)), seconds, lambda: 0.6)
    return keys.clip("guided", t, fps)


def _turn_head(keys: Keyframes, away: Float[Array, "3"], back: tuple[float, float, float]) -> None:
    """Turn the head to yaw, pitch and roll, and back to look at the horizon."""
    for (yaw, pitch, roll), rest in ((away.tolist(), 0.0), (back, 0.6)):
        keys.gaze(yaw, pitch, 0.75, roll=roll)
        keys.wait(0.8 * keys.pace + rest)


def _raise_arms(keys: Keyframes) -> None:
    for hands in ARM_MOVES:
        keys.both_hands(hands)
        keys.wait(1.1 * keys.pace)


def _horizon(rng: np.random.Generator) -> tuple[float, float, float]:
    yaw, pitch, roll = NATURAL_HEAD * rng.standard_normal(3)
    return float(yaw), float(pitch), float(roll)


NATURAL_HEAD = np.deg2rad([1.9, 1.9, 1.0])
"""Standard deviations of yaw, pitch and roll of a head asked to look at the horizon."""
LOOKING_AT_MARK = 0.25
"""Idle turning of the head, against that of a person who looks at nothing."""
HEAD_MOVES = (
    (0.0, 0.55, 0.0), (0.9, 0.0, 0.0), (0.0, 0.0, 0.4),
    (0.0, -0.4, 0.0), (-0.9, 0.0, 0.0), (0.0, 0.0, -0.4),
)  # fmt: skip
"""Yaw, pitch and roll of the head, radians: nods, turns, tilts."""
ARM_MOVES = (Hand((0.5, 0.0, 0.0), 1.0), Hand((0.05, 0.5, 0.0), 0.6), DOWN)
