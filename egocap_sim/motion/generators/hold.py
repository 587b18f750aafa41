"""Standing with something in the hand: a phone to look at, a cup to drink from, a paper to read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.errors import InputError
from egocap_sim.motion.generators.keyframes import DOWN, Hand, Score
from egocap_sim.motion.generators.stance import draw_style
from egocap_sim.motion.kinematics.clip import Clip


@dataclass(frozen=True)
class HoldParams:
    """What is done with the thing that is held."""

    use: str = "phone"
    """'phone', 'drink' or 'read'."""
    hand: str = "right"
    """The hand that holds, 'left' or 'right'; reading takes both."""
    pace: float = 1.0
    """Factor on the duration of moves, 0.5 to 2."""


def _phone(score: Score, hand: int) -> None:
    """Look at it, tap with the other hand, look up."""
    rng = score.rng
    near = Hand((0.27, -0.06, -0.20 + rng.uniform(-0.03, 0.03)), -0.9, 0.1)
    score.clock = score.hand(hand, near)
    score.gaze(rng.uniform(-0.1, 0.1), 0.5)
    for _ in range(int(rng.integers(2, 5))):
        score.clock = score.hand(1 - hand, Hand((0.31, -0.17, -0.14), 1.1), 0.35 * score.pace)
        away = Hand((0.29, -0.12 + rng.normal(0, 0.01), -0.10), 1.1)
        score.clock = score.hand(1 - hand, away, 0.25 * score.pace)
    score.hand(1 - hand, DOWN)
    score.wait(rng.uniform(0.5, 1.5))
    score.gaze(rng.uniform(-0.5, 0.5), 0.05)
    score.wait(rng.uniform(0.4, 1.0))


def _drink(score: Score, hand: int) -> None:
    """Hold it before the body, bring it to the mouth, and back."""
    rng = score.rng
    score.clock = score.hand(hand, Hand((0.28, -0.02, -0.27), 0.0))
    score.gaze(rng.uniform(-0.3, 0.3), 0.1)
    score.wait(rng.uniform(0.4, 1.5))
    score.gaze(0.0, -0.12)
    score.clock = score.hand(hand, Hand((0.24, -0.12, 0.0), 0.15, 0.0, 0.35))
    score.wait(rng.uniform(0.5, 1.0))


def _read(score: Score, hand: int) -> None:
    """Hold it open before the chest and let the eyes wander over it."""
    rng = score.rng
    height = rng.uniform(-0.14, -0.08)
    ends = [score.hand(h, Hand((0.36, 0.02, height), 0.15)) for h in (0, 1)]
    score.clock = max(ends)
    for _ in range(int(rng.integers(2, 5))):
        score.gaze(rng.uniform(-0.15, 0.15), rng.uniform(0.2, 0.45), 0.6)
        score.wait(rng.uniform(0.6, 1.2))


USES: dict[str, Callable[[Score, int], None]] = {"phone": _phone, "drink": _drink, "read": _read}

_FIRST = {
    "phone": Hand((0.27, -0.06, -0.20), -0.9, 0.1),
    "drink": Hand((0.28, -0.02, -0.27), 0.0),
    "read": Hand((0.36, 0.02, -0.11), 0.15),
}  # where the hand is at the start


def hold(t: Float[Array, "T"], rng: np.random.Generator, params: HoldParams, fps: float) -> Clip:
    """Use the held thing again and again for the times t [s]. Raises InputError for other uses."""
    if params.use not in USES:
        raise InputError(f"use '{params.use}'", valid=USES)
    if params.hand not in ("left", "right"):
        raise InputError(f"hand '{params.hand}'", valid="left, right")
    score = Score(draw_style(rng), rng, params.pace)
    hand = int(params.hand == "right")
    for h in (0, 1) if params.use == "read" else (hand,):
        score.begin(h, _FIRST[params.use])
    while score.perform([lambda s: USES[params.use](s, hand)], float(t[-1])):
        pass
    return score.clip("hold", t, fps)
