"""Tasks, standing or seated: use a held object, work at a desk or a counter, shake hands."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.motion.generators.keyframes import DOWN, Hand, Keyframes, PaceParams
from egocap_sim.motion.generators.postures import SEAT_TO_PELVIS
from egocap_sim.motion.generators.stance import HIP_HEIGHT, draw_style
from egocap_sim.motion.kinematics.clip import Clip

RIGHT = 1
OFFERED = Hand((0.44, -0.07, -0.31), 0.0, 0.05)
"""The offered hand: thumb up, towards the middle, at navel height."""
_HEIGHT = -0.27  # metres of the wrists from the shoulders: hands on a desk's top
_KEYS = Hand((0.37, -0.05, _HEIGHT), 1.35, 0.1)  # on the keyboard


Task = Callable[[Keyframes, int], None]
"""Adds the keys of one task: (keys, hand (0 left, 1 right))."""


def _phone(keys: Keyframes, hand: int) -> None:
    """Look at a phone, tap with the other hand, look up."""
    rng = keys.rng
    near = Hand((0.27, -0.06, -0.20 + rng.uniform(-0.03, 0.03)), -0.9, 0.1)
    keys.clock = keys.hand(hand, near)
    keys.gaze(rng.uniform(-0.1, 0.1), 0.5)
    for _ in range(int(rng.integers(2, 5))):
        keys.clock = keys.hand(1 - hand, Hand((0.31, -0.17, -0.14), 1.1), 0.35 * keys.pace)
        away = Hand((0.29, -0.12 + rng.normal(0, 0.01), -0.10), 1.1)
        keys.clock = keys.hand(1 - hand, away, 0.25 * keys.pace)
    keys.hand(1 - hand, DOWN)
    keys.wait(rng.uniform(0.5, 1.5))
    keys.gaze(rng.uniform(-0.5, 0.5), 0.05)
    keys.wait(rng.uniform(0.4, 1.0))


def _drink(keys: Keyframes, hand: int) -> None:
    """Hold a cup before the body and bring it to the mouth."""
    rng = keys.rng
    keys.clock = keys.hand(hand, Hand((0.28, -0.02, -0.27), 0.0))
    keys.gaze(rng.uniform(-0.3, 0.3), 0.1)
    keys.wait(rng.uniform(0.4, 1.5))
    keys.gaze(0.0, -0.12)
    keys.clock = keys.hand(hand, Hand((0.24, -0.12, 0.0), 0.15, 0.0, 0.35))
    keys.wait(rng.uniform(0.5, 1.0))


def _read(keys: Keyframes, hand: int) -> None:
    """Hold a newspaper open before the chest and move the gaze over it."""
    rng = keys.rng
    height = rng.uniform(-0.14, -0.08)
    keys.clock = keys.both_hands(Hand((0.36, 0.02, height), 0.15))
    for _ in range(int(rng.integers(2, 5))):
        keys.gaze(rng.uniform(-0.15, 0.15), rng.uniform(0.2, 0.45), 0.6)
        keys.wait(rng.uniform(0.6, 1.2))


USES: dict[str, tuple[Task, Hand]] = {
    "phone": (_phone, Hand((0.27, -0.06, -0.20), -0.9, 0.1)),
    "drink": (_drink, Hand((0.28, -0.02, -0.27), 0.0)),
    "read": (_read, Hand((0.36, 0.02, -0.11), 0.15)),
}
"""Uses of a held object, and the initial key of the hand."""


@dataclass(frozen=True)
class HoldParams(PaceParams):
    """Use of a held object."""

    use: Annotated[str, USES] = "phone"
    hand: Annotated[str, ("left", "right")] = "right"
    """The hand that holds; reading uses both."""


def hold(t: Float[Array, "T"], rng: np.random.Generator, params: HoldParams, fps: float) -> Clip:
    """Use the held object repeatedly for the times t [s]."""
    keys = Keyframes(draw_style(rng), rng, params.pace)
    hand = int(params.hand == "right")
    use, first = USES[params.use]
    keys.begin(first, (0, 1) if params.use == "read" else (hand,))
    keys.repeat(lambda k: use(k, hand), float(t[-1]))
    return keys.clip("hold", t, fps)


def _typing(keys: Keyframes, hand: int) -> None:
    """Both hands on the keyboard, moving a little along it; eyes on the screen, then the keys."""
    rng = keys.rng
    keys.gaze(rng.uniform(-0.1, 0.1), rng.uniform(0.15, 0.3))
    keys.trunk(0.0, rng.uniform(0.02, 0.14), 0.0, 0.9 * keys.pace)
    keys.clock = max(keys.hand(h, _near(rng, _KEYS, 0.01)) for h in (0, 1))
    for _ in range(int(rng.integers(6, 14))):
        ends = [keys.hand(h, _near(rng, _KEYS, 0.012), 0.18 * keys.pace) for h in (0, 1)]
        if rng.random() < 0.2:
            keys.gaze(rng.uniform(-0.15, 0.15), rng.choice([0.2, 0.5]), 0.4)
        keys.clock = max(ends)
        keys.wait(rng.uniform(0.0, 0.12))


def _mouse(keys: Keyframes, hand: int) -> None:
    """Move a mouse beside the keyboard with one hand."""
    rng = keys.rng
    spot = Hand((0.38, 0.10, _HEIGHT), 1.3, 0.15)
    keys.gaze(rng.uniform(-0.2, 0.2), rng.uniform(0.1, 0.25))
    keys.clock = keys.hand(hand, spot)
    for _ in range(int(rng.integers(4, 9))):
        keys.clock = keys.hand(hand, _near(rng, spot, 0.03), rng.uniform(0.2, 0.5) * keys.pace)
        if rng.random() < 0.4:
            keys.gaze(rng.uniform(-0.3, 0.3), rng.uniform(0.1, 0.25), 0.3)
        keys.wait(rng.uniform(0.05, 0.5))


def _writing(keys: Keyframes, hand: int) -> None:
    """Lean over a sheet; one hand holds it, the other writes line by line."""
    rng = keys.rng
    keys.trunk(0.0, rng.uniform(0.14, 0.24), 0.0, 1.0 * keys.pace)
    keys.gaze(0.0, rng.uniform(0.45, 0.6))
    held = keys.hand(1 - hand, Hand((0.36, 0.02, _HEIGHT + 0.01), 1.3))
    keys.clock = max(held, keys.hand(hand, Hand((0.34, -0.10, _HEIGHT + 0.03), 0.8)))
    for _ in range(int(rng.integers(2, 5))):
        for y in np.arange(-0.14, 0.02, 0.02):  # left to right for a right hand
            away = y if hand else -y - 0.12
            z = _HEIGHT + 0.03 + rng.uniform(-0.004, 0.004)
            keys.clock = keys.hand(hand, Hand((0.34, away, z), 0.8), 0.22 * keys.pace)
        keys.wait(rng.uniform(0.1, 0.6))


TASKS: dict[str, Task] = {"typing": _typing, "mouse": _mouse, "writing": _writing}


@dataclass(frozen=True)
class DeskParams(PaceParams):
    """Work at a desk."""

    tasks: Annotated[tuple[str, ...], TASKS] = ()
    """Names of tasks; empty: all of them."""
    seat: Annotated[float, (0.35, 0.6)] = 0.46
    """Height of the seat in metres."""


def desk(t: Float[Array, "T"], rng: np.random.Generator, params: DeskParams, fps: float) -> Clip:
    """Sit and work for the times t [s]."""
    tasks = list(params.tasks or TASKS)
    style = draw_style(rng)
    keys = Keyframes(style, rng, params.pace)
    keys.begin_pelvis(-0.40, 0.0, params.seat + SEAT_TO_PELVIS - HIP_HEIGHT)
    keys.begin(_KEYS)
    hand = 0 if style.handed > 0 else 1
    waiting: list[str] = []
    while True:
        waiting = waiting or [tasks[i] for i in rng.permutation(len(tasks))]
        moves = [lambda keys, kind=kind: TASKS[kind](keys, hand) for kind in waiting]
        if not keys.perform(moves, float(t[-1])):
            return keys.clip("desk", t, fps, balance=False)
        waiting.pop(0)
        keys.wait(rng.uniform(0.1, 0.6))


def _near(rng: np.random.Generator, key: Hand, spread: float) -> Hand:
    """A key with noise along the desk top."""
    x, y, z = key.wrist
    dx, dy = rng.normal(0.0, spread, 2)
    return Hand((x + dx, y + dy, z + abs(rng.normal(0.0, 0.004))), key.pronation, key.bend)


@dataclass(frozen=True)
class WorkParams(PaceParams):
    """Work with the hands at one height."""

    height: Annotated[float, (-0.4, -0.2)] = -0.33
    """Metres of the wrists from the shoulders."""


def work(t: Float[Array, "T"], rng: np.random.Generator, params: WorkParams, fps: float) -> Clip:
    """Reach for objects on a counter and stir, cut or wipe with the other hand, for times t [s]."""
    keys = Keyframes(draw_style(rng), rng, params.pace)
    z = params.height
    ready = Hand((0.30, -0.02, z), 1.0)

    def once(keys: Keyframes) -> None:
        rng, hand = keys.rng, int(keys.rng.random() < 0.7)
        keys.trunk(rng.uniform(-0.1, 0.1), rng.uniform(0.08, 0.2), 0.0, 0.8)
        keys.gaze(rng.uniform(-0.2, 0.2), rng.uniform(0.35, 0.6))
        spot = np.array([rng.uniform(0.36, 0.44), rng.uniform(-0.05, 0.16), z + 0.02])
        keys.clock = keys.hand(hand, Hand((spot[0], spot[1], spot[2]), 1.0))
        keys.hand(1 - hand, ready)
        back = keys.hand(hand, Hand((0.30, -0.06, z + 0.03), 0.6))
        keys.clock = max(back, keys.clock)
        for k in range(int(rng.integers(3, 8))):
            stroke = 0.05 if k % 2 else -0.03
            at = Hand((0.31 + stroke, -0.06 + 0.4 * stroke, z + 0.02), 0.7)
            keys.clock = keys.hand(hand, at, rng.uniform(0.25, 0.4) * keys.pace)

    keys.begin(ready)
    keys.repeat(once, float(t[-1]), lambda: rng.uniform(0.1, 0.4))
    return keys.clip("work", t, fps)


def handshake(
    t: Float[Array, "T"], rng: np.random.Generator, params: PaceParams, fps: float
) -> Clip:
    """Offer the right hand, shake, let go and gesture, for the times t [s]."""
    keys = Keyframes(draw_style(rng), rng, params.pace)
    keys.wait(rng.uniform(0.4, 0.8))

    def once(keys: Keyframes) -> None:
        rng = keys.rng
        keys.gaze(0.0, rng.uniform(0.0, 0.15))
        keys.trunk(0.0, rng.uniform(0.05, 0.12), 0.0, 0.8 * keys.pace)
        give(keys, 0.75 * keys.pace)
        for k in range(2 * int(rng.integers(2, 5))):
            shake(keys, k, 0.17 * keys.pace)
        keys.wait(rng.uniform(0.1, 0.6))
        keys.trunk(0.0, 0.0, 0.0, 0.8 * keys.pace)
        keys.clock = keys.hand(RIGHT, DOWN, 0.8 * keys.pace)

    while keys.perform([once], float(t[-1])):
        if rng.random() < 0.6:
            keys.hand(1 - RIGHT, Hand((0.28, 0.12, -0.30), 0.2), 0.6)
            keys.wait(0.9)
            keys.hand(1 - RIGHT, DOWN, 0.7)
        keys.wait(rng.uniform(0.8, 2.0))
    return keys.clip("handshake", t, fps)


def give(keys: Keyframes, seconds: float) -> None:
    """Offer the right hand."""
    keys.clock = keys.hand(RIGHT, OFFERED, seconds)


def shake(keys: Keyframes, stroke: int, seconds: float) -> None:
    """One stroke up or down."""
    x, y, z = OFFERED.wrist
    up = Hand((x, y, z + (0.035 if stroke % 2 == 0 else -0.03)), OFFERED.pronation, OFFERED.bend)
    keys.clock = keys.hand(RIGHT, up, seconds)
