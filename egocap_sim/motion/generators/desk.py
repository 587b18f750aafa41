"""Seated at a desk: typing, using a mouse, writing. Legs stay below the top, hands on it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.errors import InputError
from egocap_sim.motion.generators.keyframes import Hand, Score
from egocap_sim.motion.generators.postures import SEAT_TO_PELVIS
from egocap_sim.motion.generators.stance import HIP_HEIGHT, draw_style
from egocap_sim.motion.kinematics.clip import Clip

_HEIGHT = -0.27  # metres of the wrists from the shoulders: hands on the top
_KEYS = Hand((0.37, -0.05, _HEIGHT), 1.35, 0.1)  # on the keyboard


@dataclass(frozen=True)
class DeskParams:
    """Work at a desk."""

    tasks: tuple[str, ...] = ()
    """Of 'typing', 'mouse' and 'writing'; empty: all of them."""
    seat: float = 0.46
    """Height of the seat in metres, 0.35 to 0.6."""
    pace: float = 1.0
    """Factor on the duration of moves, 0.5 to 2."""


def _typing(score: Score, hand: int) -> None:
    """Both hands on the keyboard, moving a little along it; eyes on the screen, then the keys."""
    rng = score.rng
    score.gaze(rng.uniform(-0.1, 0.1), rng.uniform(0.15, 0.3))
    score.trunk(0.0, rng.uniform(0.02, 0.14), 0.0, 0.9 * score.pace)
    score.clock = max(score.hand(h, _near(rng, _KEYS, 0.01)) for h in (0, 1))
    for _ in range(int(rng.integers(6, 14))):
        ends = [score.hand(h, _near(rng, _KEYS, 0.012), 0.18 * score.pace) for h in (0, 1)]
        if rng.random() < 0.2:
            score.gaze(rng.uniform(-0.15, 0.15), rng.choice([0.2, 0.5]), 0.4)
        score.clock = max(ends)
        score.wait(rng.uniform(0.0, 0.12))


def _mouse(score: Score, hand: int) -> None:
    """One hand pushes a mouse about beside the keyboard."""
    rng = score.rng
    spot = Hand((0.38, 0.10, _HEIGHT), 1.3, 0.15)
    score.gaze(rng.uniform(-0.2, 0.2), rng.uniform(0.1, 0.25))
    score.clock = score.hand(hand, spot)
    for _ in range(int(rng.integers(4, 9))):
        score.clock = score.hand(hand, _near(rng, spot, 0.03), rng.uniform(0.2, 0.5) * score.pace)
        if rng.random() < 0.4:
            score.gaze(rng.uniform(-0.3, 0.3), rng.uniform(0.1, 0.25), 0.3)
        score.wait(rng.uniform(0.05, 0.5))


def _writing(score: Score, hand: int) -> None:
    """Lean over a sheet: one hand holds it, the other writes line by line."""
    rng = score.rng
    score.trunk(0.0, rng.uniform(0.14, 0.24), 0.0, 1.0 * score.pace)
    score.gaze(0.0, rng.uniform(0.45, 0.6))
    held = score.hand(1 - hand, Hand((0.36, 0.02, _HEIGHT + 0.01), 1.3))
    score.clock = max(held, score.hand(hand, Hand((0.34, -0.10, _HEIGHT + 0.03), 0.8)))
    for _ in range(int(rng.integers(2, 5))):
        for y in np.arange(-0.14, 0.02, 0.02):  # left to right for a right hand
            away = y if hand else -y - 0.12
            z = _HEIGHT + 0.03 + rng.uniform(-0.004, 0.004)
            score.clock = score.hand(hand, Hand((0.34, away, z), 0.8), 0.22 * score.pace)
        score.wait(rng.uniform(0.1, 0.6))


TASKS: dict[str, Callable[[Score, int], None]] = {
    "typing": _typing, "mouse": _mouse, "writing": _writing,
}  # fmt: skip


def desk(t: Float[Array, "T"], rng: np.random.Generator, params: DeskParams, fps: float) -> Clip:
    """Sit and work for the times t [s]. Raises InputError for other tasks."""
    unknown = [task for task in params.tasks if task not in TASKS]
    if unknown:
        raise InputError(f"unknown task '{unknown[0]}'", valid=TASKS)
    tasks = list(params.tasks or TASKS)
    style = draw_style(rng)
    score = Score(style, rng, params.pace)
    score.begin_pelvis(-0.40, 0.0, params.seat + SEAT_TO_PELVIS - HIP_HEIGHT)
    for hand in (0, 1):
        score.begin(hand, _KEYS)
    hand = 0 if style.handed > 0 else 1
    waiting: list[str] = []
    while True:
        waiting = waiting or [tasks[i] for i in rng.permutation(len(tasks))]
        moves = [_work(kind, hand) for kind in waiting]
        if not score.perform(moves, float(t[-1])):
            return score.clip("desk", t, fps, balance=False)
        waiting.pop(0)
        score.wait(rng.uniform(0.1, 0.6))


def _work(kind: str, hand: int) -> Callable[[Score], None]:
    return lambda score: TASKS[kind](score, hand)


def _near(rng: np.random.Generator, key: Hand, spread: float) -> Hand:
    """A key moved a little along the top."""
    x, y, z = key.wrist
    dx, dy = rng.normal(0.0, spread, 2)
    return Hand((x + dx, y + dy, z + abs(rng.normal(0.0, 0.004))), key.pronation, key.bend)
