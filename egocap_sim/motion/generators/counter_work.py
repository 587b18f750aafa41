"""Standing at a counter: both hands busy a little above its top."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.motion.generators.keyframes import Hand, Score
from egocap_sim.motion.generators.stance import draw_style
from egocap_sim.motion.kinematics.clip import Clip


@dataclass(frozen=True)
class WorkParams:
    """Work with the hands at one height."""

    height: float = -0.33
    """Metres of the wrists from the shoulders, -0.4 to -0.2."""
    pace: float = 1.0
    """Factor on the duration of moves, 0.5 to 2."""


def work(t: Float[Array, "T"], rng: np.random.Generator, params: WorkParams, fps: float) -> Clip:
    """Reach for things on a counter, hold them with one hand and stir, cut or wipe with the other,
    for the times t [s]."""
    score = Score(draw_style(rng), rng, params.pace)
    z = params.height
    ready = Hand((0.30, -0.02, z), 1.0)

    def once(score: Score) -> None:
        rng, hand = score.rng, int(score.rng.random() < 0.7)
        score.trunk(rng.uniform(-0.1, 0.1), rng.uniform(0.08, 0.2), 0.0, 0.8)
        score.gaze(rng.uniform(-0.2, 0.2), rng.uniform(0.35, 0.6))
        spot = np.array([rng.uniform(0.36, 0.44), rng.uniform(-0.05, 0.16), z + 0.02])
        score.clock = score.hand(hand, Hand((spot[0], spot[1], spot[2]), 1.0))
        score.hand(1 - hand, ready)
        back = score.hand(hand, Hand((0.30, -0.06, z + 0.03), 0.6))
        score.clock = max(back, score.clock)
        for k in range(int(rng.integers(3, 8))):
            stroke = 0.05 if k % 2 else -0.03
            at = Hand((0.31 + stroke, -0.06 + 0.4 * stroke, z + 0.02), 0.7)
            score.clock = score.hand(hand, at, rng.uniform(0.25, 0.4) * score.pace)

    for hand in (0, 1):
        score.begin(hand, ready)
    while score.perform([once], float(t[-1])):
        score.wait(rng.uniform(0.1, 0.4))
    return score.clip("work", t, fps)
