"""Gestures and reaches of a standing person: one function each, listed in `GESTURES`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.motion.generators.keyframes import DOWN, Hand, Keyframes, PaceParams
from egocap_sim.motion.generators.stance import draw_style
from egocap_sim.motion.kinematics.clip import Clip

Gesture = Callable[[Keyframes, int, float, np.random.Generator], None]
"""Adds the keys of one gesture: (keys, hand (0 left, 1 right), size, random generator)."""


def _near(rng: np.random.Generator, size: float, key: Hand, spread: float = 0.02) -> Hand:
    """A key with noise; `size` scales its offset from the hanging hand."""
    wrist = np.asarray(DOWN.wrist) + (np.asarray(key.wrist) - DOWN.wrist) * min(size, 1.15)
    wrist = wrist + rng.normal(0.0, spread, 3)
    return Hand((wrist[0], wrist[1], wrist[2]), key.pronation, key.bend, key.swivel)


def _back(keys: Keyframes, *hands: int) -> None:
    """Return the hands, the trunk and the head to rest."""
    ends = [keys.hand(hand, DOWN) for hand in hands]
    keys.trunk(0.0, 0.0, 0.0, 0.8 * keys.pace)
    keys.gaze(0.0, 0.0, 0.6)
    keys.clock = max(ends)


def wave(keys: Keyframes, hand: int, size: float, rng: np.random.Generator) -> None:
    """Raise a hand beside the head and wave it from the elbow."""
    side = 1.0 - 2.0 * hand
    up = _near(rng, size, Hand((0.15, 0.25, 0.18), 1.35, swivel=0.15))
    keys.gaze(side * rng.uniform(-0.1, 0.35), -0.05)
    keys.clock = keys.hand(hand, up)
    for n in range(int(rng.integers(4, 8))):
        x, y, z = up.wrist
        sway = Hand((x, y + (0.10 if n % 2 else -0.08) * size, z), 1.35, 0.1, 0.15)
        keys.clock = keys.hand(hand, sway, rng.uniform(0.2, 0.27) * keys.pace)
    _back(keys, hand)


def point(keys: Keyframes, hand: int, size: float, rng: np.random.Generator) -> None:
    """Point at something ahead or to the side, looking at it."""
    side = 1.0 - 2.0 * hand
    yaw, lift = rng.uniform(-0.3, 1.2), rng.uniform(-0.35, 0.35)
    reach = 0.535 * np.array([np.cos(yaw) * np.cos(lift), np.sin(yaw) * np.cos(lift), np.sin(lift)])
    keys.gaze(side * yaw * 0.85, -0.6 * lift, 0.45)
    keys.trunk(side * 0.3 * yaw, 0.03, 0.0, 0.8 * keys.pace)
    keys.wait(0.12)
    yaw_left = 0.7 * yaw  # the chest has turned towards it
    reach[:2] = 0.535 * np.cos(lift) * np.array([np.cos(yaw_left), np.sin(yaw_left)])
    keys.clock = keys.hand(hand, Hand((reach[0], reach[1], reach[2]), 1.2))
    keys.wait(rng.uniform(0.5, 1.2))
    _back(keys, hand)


def explain(keys: Keyframes, hand: int, size: float, rng: np.random.Generator) -> None:
    """Talk with both hands: beats with open palms before the body."""
    beats = [
        Hand((0.31, 0.02, -0.26), -0.4), Hand((0.30, 0.20, -0.22), -0.7),
        Hand((0.34, 0.06, -0.12), 0.3), Hand((0.33, -0.06, -0.22), 0.9),
        Hand((0.26, 0.12, -0.30), 0.5),
    ]  # fmt: skip
    for _ in range(int(rng.integers(4, 8))):
        key = beats[int(rng.integers(len(beats)))]
        both = rng.random() < 0.6
        ends = [keys.hand(hand, _near(rng, size, key, 0.03))]
        if both:
            ends.append(keys.hand(1 - hand, _near(rng, size, key, 0.03), later=rng.uniform(0, 0.1)))
        if rng.random() < 0.5:
            keys.gaze(rng.uniform(-0.35, 0.35), rng.uniform(-0.1, 0.2), 0.45)
        keys.trunk(rng.uniform(-0.12, 0.12), rng.uniform(0.0, 0.06), 0.0, 0.7 * keys.pace)
        keys.clock = max(ends)
        keys.wait(rng.uniform(0.02, 0.35))
    _back(keys, 0, 1)


def reach_high(keys: Keyframes, hand: int, size: float, rng: np.random.Generator) -> None:
    """Reach for something on a high shelf."""
    side = 1.0 - 2.0 * hand
    top = _near(rng, size, Hand((0.27, 0.05, 0.45), 0.9, swivel=0.2))
    keys.gaze(side * 0.1, -0.5)
    keys.trunk(-side * 0.15, -0.03, -side * 0.1, 0.9 * keys.pace)
    keys.clock = keys.hand(hand, top)
    keys.wait(rng.uniform(0.3, 0.9))
    _back(keys, hand)


def reach_low(keys: Keyframes, hand: int, size: float, rng: np.random.Generator) -> None:
    """Stoop with bent knees and touch something low in front."""
    side = 1.0 - 2.0 * hand
    seconds = rng.uniform(1.0, 1.3) * keys.pace
    keys.gaze(0.0, 0.75, 0.6)
    keys.trunk(-side * 0.12, 0.85 * size, 0.0, seconds)
    keys.pelvis(-0.08, 0.0, -0.24 * size, seconds)
    keys.hand(hand, Hand((0.42, -0.08, -0.36), 0.7), seconds)
    keys.hand(1 - hand, Hand((0.22, 0.04, -0.46), 0.5), seconds)
    keys.wait(seconds + rng.uniform(0.15, 0.5))
    keys.pelvis(0.0, 0.0, 0.0, 1.1 * keys.pace)
    keys.hand(1 - hand, DOWN, 1.1 * keys.pace)
    keys.hand(hand, DOWN, 1.1 * keys.pace)
    keys.trunk(0.0, 0.0, 0.0, 1.1 * keys.pace)
    keys.gaze(0.0, 0.0, 0.9)
    keys.wait(1.15 * keys.pace)


def reach_side(keys: Keyframes, hand: int, size: float, rng: np.random.Generator) -> None:
    """Reach out sideways, leaning a little, and look there."""
    side = 1.0 - 2.0 * hand
    keys.gaze(side * 0.75, 0.15)
    keys.trunk(side * 0.25, 0.05, -side * 0.1, 0.9 * keys.pace)
    keys.wait(0.1)
    keys.clock = keys.hand(hand, _near(rng, size, Hand((0.16, 0.49, -0.05), 1.0)))
    keys.wait(rng.uniform(0.3, 0.8))
    _back(keys, hand)


def hands_together(keys: Keyframes, hand: int, size: float, rng: np.random.Generator) -> None:
    """Bring both hands together before the chest or the belly."""
    height = rng.uniform(-0.3, -0.12)
    key = Hand((0.27, -0.135, height), 0.15, 0.2, 0.25)
    keys.gaze(0.0, 0.2)
    keys.clock = keys.both_hands(key)
    keys.wait(rng.uniform(0.5, 1.4))
    if rng.random() < 0.5:  # rub or clap
        for n in range(4):
            apart = Hand((0.27, -0.135 + (0.0 if n % 2 else 0.07), height), 0.15, 0.2, 0.25)
            keys.clock = keys.both_hands(apart, 0.22 * keys.pace)
    _back(keys, 0, 1)


def touch_head(keys: Keyframes, hand: int, size: float, rng: np.random.Generator) -> None:
    """Bring a hand to the chin or the temple, thinking."""
    chin = rng.random() < 0.5
    key = (
        Hand((0.20, -0.10, -0.03), 0.4, 0.25) if chin else Hand((0.15, 0.02, 0.14), 0.5, 0.3, 0.35)
    )
    keys.gaze(rng.uniform(-0.2, 0.2), 0.15)
    keys.clock = keys.hand(hand, _near(rng, 1.0, key, 0.01))
    keys.wait(rng.uniform(0.5, 1.3))
    _back(keys, hand)


def cross_reach(keys: Keyframes, hand: int, size: float, rng: np.random.Generator) -> None:
    """Reach across the body to the other side."""
    side = 1.0 - 2.0 * hand
    keys.gaze(-side * 0.6, 0.25)
    keys.trunk(-side * 0.35, 0.08, 0.0, 0.9 * keys.pace)
    keys.clock = keys.hand(hand, _near(rng, size, Hand((0.40, -0.22, -0.16), 0.8)))
    keys.wait(rng.uniform(0.2, 0.6))
    _back(keys, hand)


GESTURES: dict[str, Gesture] = {
    gesture.__name__: gesture
    for gesture in (
        wave, point, explain, reach_high, reach_low, reach_side, cross_reach, hands_together,
        touch_head,
    )
}  # fmt: skip


@dataclass(frozen=True)
class GestureParams(PaceParams):
    """Which gestures, and how they are made."""

    kinds: Annotated[tuple[str, ...], GESTURES] = ()
    """Gestures to draw from; empty: all."""
    hand: Annotated[str, ("left", "right", "any")] = "any"
    """'any': mostly the dominant hand."""
    size: Annotated[float, (0.4, 1.15)] = 1.0
    """Factor on how far gestures reach."""


def gesticulate(
    t: Float[Array, "T"], rng: np.random.Generator, params: GestureParams, fps: float
) -> Clip:
    """Stand and make random gestures with short rests, for the times t [s].

    Each round contains every gesture once. Gestures that would end too late are left out.
    """
    kinds = list(params.kinds or GESTURES)
    style = draw_style(rng)
    keys = Keyframes(style, rng, params.pace)
    keys.wait(rng.uniform(0.2, 0.5))
    waiting: list[str] = []
    while True:
        waiting = waiting or [kinds[i] for i in rng.permutation(len(kinds))]
        better = style.handed if rng.random() < 0.65 else -style.handed
        hand = {"left": 0, "right": 1}.get(params.hand, 0 if better > 0 else 1)
        moves = [
            lambda keys, make=GESTURES[kind], hand=hand: make(keys, hand, params.size, keys.rng)
            for kind in waiting
        ]
        if not keys.perform(moves, float(t[-1])):
            return keys.clip("gestures", t, fps)
        waiting.pop(0)
        keys.wait(rng.uniform(0.1, 0.5) * keys.pace)
