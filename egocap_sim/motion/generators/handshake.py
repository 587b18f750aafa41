"""Shaking hands: the right hand goes out, is shaken, and comes back, again and again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.motion.generators.keyframes import DOWN, Hand, Score
from egocap_sim.motion.generators.stance import draw_style
from egocap_sim.motion.kinematics.clip import Clip

RIGHT = 1
OFFERED = Hand((0.44, -0.07, -0.31), 0.0, 0.05)
"""The hand given: thumb up, a little to the middle, at the height of the navel."""


@dataclass(frozen=True)
class HandshakeParams:
    """Greeting somebody."""

    pace: float = 1.0
    """Factor on the duration of moves, 0.5 to 2."""


def handshake(
    t: Float[Array, "T"], rng: np.random.Generator, params: HandshakeParams, fps: float
) -> Clip:
    """Give the right hand, shake, let go and talk, for the times t [s]."""
    score = Score(draw_style(rng), rng, params.pace)
    score.wait(rng.uniform(0.4, 0.8))

    def once(score: Score) -> None:
        rng = score.rng
        score.gaze(0.0, rng.uniform(0.0, 0.15))
        score.trunk(0.0, rng.uniform(0.05, 0.12), 0.0, 0.8 * score.pace)
        give(score, 0.75 * score.pace)
        for k in range(2 * int(rng.integers(2, 5))):
            shake(score, k, 0.17 * score.pace)
        score.wait(rng.uniform(0.1, 0.6))
        score.trunk(0.0, 0.0, 0.0, 0.8 * score.pace)
        score.clock = score.hand(RIGHT, DOWN, 0.8 * score.pace)

    while score.perform([once], float(t[-1])):
        if rng.random() < 0.6:
            score.hand(1 - RIGHT, Hand((0.28, 0.12, -0.30), 0.2), 0.6)
            score.wait(0.9)
            score.hand(1 - RIGHT, DOWN, 0.7)
        score.wait(rng.uniform(0.8, 2.0))
    return score.clip("handshake", t, fps)


def give(score: Score, seconds: float) -> None:
    """Put the hand forward."""
    score.clock = score.hand(RIGHT, OFFERED, seconds)


def shake(score: Score, stroke: int, seconds: float) -> None:
    """One stroke up or down."""
    x, y, z = OFFERED.wrist
    up = Hand((x, y, z + (0.035 if stroke % 2 == 0 else -0.03)), OFFERED.pronation, OFFERED.bend)
    score.clock = score.hand(RIGHT, up, seconds)
