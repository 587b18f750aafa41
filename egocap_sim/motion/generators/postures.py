"""Whole-body moves on planted feet: squat, sit down and stand up, look around, stand idle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.motion.generators.keyframes import DOWN, Hand, Score
from egocap_sim.motion.generators.stance import HIP_HEIGHT, draw_style
from egocap_sim.motion.kinematics.clip import Clip

SEAT_TO_PELVIS = 0.115  # metres from a seat to the pelvis joint of someone sitting on it


@dataclass(frozen=True)
class SquatParams:
    """Squats, one after another."""

    depth: float = 0.8
    """1: the thighs are level; 0.2 to 1."""
    pace: float = 1.0
    """Factor on the duration, 0.6 to 2."""


def squat(t: Float[Array, "T"], rng: np.random.Generator, params: SquatParams, fps: float) -> Clip:
    """Squats with the arms stretched forward for balance, for the times t [s]."""
    score = Score(draw_style(rng), rng, params.pace)
    score.wait(rng.uniform(0.3, 0.5))

    def once(score: Score) -> None:
        depth = float(np.clip(params.depth * rng.uniform(0.9, 1.05), 0.1, 1.05))
        down, up = rng.uniform(1.1, 1.4) * score.pace, rng.uniform(0.95, 1.2) * score.pace
        score.pelvis(-0.16 * depth, 0.0, -0.36 * depth, down)
        score.trunk(0.0, 0.62 * depth, 0.0, down)
        score.gaze(0.0, 0.12, down)
        for hand in (0, 1):
            score.hand(hand, Hand((0.50, 0.0, -0.10), 1.2), down)
        score.wait(down + rng.uniform(0.1, 0.4))
        score.pelvis(0.0, 0.0, 0.0, up)
        score.trunk(0.0, 0.0, 0.0, up)
        score.gaze(0.0, 0.0, up)
        for hand in (0, 1):
            score.hand(hand, DOWN, up)
        score.wait(up)

    while score.perform([once], float(t[-1])):
        score.wait(rng.uniform(0.3, 0.8))
    return score.clip("squat", t, fps)


@dataclass(frozen=True)
class SitParams:
    """Sitting down onto a seat that is only implied, and standing up again."""

    seat: float = 0.46
    """Height of the seat in metres, 0.35 to 0.6."""
    stay: float = 1.5
    """Seconds to sit."""
    pace: float = 1.0
    """Factor on the duration, 0.6 to 2."""


def sit(t: Float[Array, "T"], rng: np.random.Generator, params: SitParams, fps: float) -> Clip:
    """Sit down, stay, stand up, and again, for the times t [s]."""
    score = Score(draw_style(rng), rng, params.pace)
    score.wait(rng.uniform(0.3, 0.6))
    drop, back = params.seat + SEAT_TO_PELVIS - HIP_HEIGHT, -0.40
    lap = Hand((0.34, -0.01, -0.37), 1.1)

    def once(score: Score) -> None:
        down = rng.uniform(1.5, 1.8) * score.pace
        score.trunk(0.0, 0.62, 0.0, 0.6 * down)
        score.pelvis(back, 0.0, drop, down)
        score.gaze(0.0, 0.3, 0.5 * down)
        for hand in (0, 1):
            score.hand(hand, lap, down, later=0.05)
        score.wait(0.72 * down)
        score.trunk(0.0, 0.05, 0.0, 0.55 * down)
        score.gaze(0.0, 0.0, 0.6)
        score.wait(0.5 * down + params.stay * rng.uniform(0.8, 1.2))
        up = rng.uniform(1.5, 1.8) * score.pace
        score.trunk(0.0, 0.68, 0.0, 0.45 * up)
        score.gaze(0.0, 0.2, 0.5)
        score.wait(0.3 * up)
        score.pelvis(0.0, 0.0, 0.0, 0.75 * up)
        for hand in (0, 1):
            score.hand(hand, DOWN, 0.7 * up)
        score.wait(0.25 * up)
        score.trunk(0.0, 0.0, 0.0, 0.6 * up)
        score.gaze(0.0, 0.0, 0.5)
        score.wait(0.65 * up)

    while score.perform([once], float(t[-1])):
        score.wait(rng.uniform(0.4, 0.9))
    return score.clip("sit", t, fps, balance=False)


@dataclass(frozen=True)
class LookParams:
    """Looking around while standing."""

    yaw: float = 1.1
    """Largest turn of the head to a side, radians, up to 1.3."""
    pace: float = 1.0
    """Factor on the duration, 0.5 to 2."""


def look_around(
    t: Float[Array, "T"], rng: np.random.Generator, params: LookParams, fps: float
) -> Clip:
    """Turn the head, and some of the trunk, to one thing after another."""
    score = Score(draw_style(rng), rng, params.pace)
    score.wait(rng.uniform(0.2, 0.5))
    side = rng.choice([-1.0, 1.0])

    def look(score: Score, yaw: float, pitch: float) -> None:
        seconds = (0.45 + 0.35 * abs(yaw)) * score.pace
        score.gaze(yaw, pitch, seconds / score.pace)
        score.trunk(0.3 * yaw, 0.0, 0.0, 1.2 * seconds)
        score.wait(1.2 * seconds)

    home = 1.2 * (0.45 + 0.35 * params.yaw) * score.pace
    while True:
        yaw, pitch = float(side * rng.uniform(0.25, 1.0) * params.yaw), rng.uniform(-0.3, 0.4)
        if not score.perform([lambda s, y=yaw, p=pitch: look(s, y, p)], float(t[-1]) - home):
            break
        score.wait(rng.uniform(0.3, 1.2))
        side = -side if rng.random() < 0.75 else side
    score.clock = min(score.clock, max(float(t[-1]) - home - 0.15, 0.0))
    look(score, 0.0, 0.0)
    return score.clip("look_around", t, fps)


@dataclass(frozen=True)
class IdleParams:
    """Standing at ease."""


def idle(t: Float[Array, "T"], rng: np.random.Generator, params: IdleParams, fps: float) -> Clip:
    """Stand, breathe, shift weight."""
    return Score(draw_style(rng), rng).clip("idle", t, fps)
