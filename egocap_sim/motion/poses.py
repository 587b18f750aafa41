"""Pose after pose, drawn at random from all that a standing person can do and hold.

Hands anywhere within reach, head, trunk and hips turned and bent within their limits, knees bent:
what ordinary motions show seldom or never, so that a detector has seen it. A draw in which a limb
would pass through the body is drawn again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.bodies import INDEX
from egocap_sim.motion.clip import Clip
from egocap_sim.motion.score import DOWN, Hand, Score
from egocap_sim.motion.stance import draw_style

_ARM_M = (0.15, 0.535)  # of the wrist from the shoulder
_TRIES = 20
_HOLD_S = (0.0, 0.5)
_TRUNK = (0.6, (-0.25, 0.9), 0.35)  # radians: yaw to either side, pitch, roll to either side
_GAZE = (1.1, (-0.6, 0.8))  # yaw to either side, pitch
_TORSO = (("pelvis", "chest", 0.13), ("chest", "neck", 0.11), ("neck", "head", 0.09))
_HEAD = (0.14, 0.13)  # metres from the skull base up to the head's middle, and its radius
_ARM_RADIUS = 0.04


@dataclass(frozen=True)
class PosesParams:
    """Random reachable poses, one after another."""

    pace: float = 1.0
    """Factor on the duration of a move, 0.5 to 2."""
    size: float = 1.0
    """Factor on how far head, trunk and hips go, 0.4 to 1.15."""


def poses(t: Float[Array, "T"], rng: np.random.Generator, params: PosesParams, fps: float) -> Clip:
    """Pose after pose, drawn at random from all that can be held standing."""
    score = Score(draw_style(rng), rng, params.pace)
    score.wait(rng.uniform(0.05, 0.3))
    while score.clock < t[-1]:
        _pose(score, rng, params.size)
    return score.clip("poses", t, fps)


def _pose(score: Score, rng: np.random.Generator, size: float) -> None:
    """Write one pose, and how long it is held."""
    for _ in range(_TRIES):
        hands = [_hand(rng) for _ in range(2)]
        trunk = _around(rng, _TRUNK[0], size), _within(rng, _TRUNK[1], size), _around(
            rng, _TRUNK[2], size)  # fmt: skip
        gaze = _around(rng, _GAZE[0], size), _within(rng, _GAZE[1], size)
        down = float(rng.beta(1.0, 2.5)) * 0.36 * size
        pelvis = -0.3 * down, float(rng.uniform(-0.05, 0.05)), -down
        held = Score(score.style, np.random.default_rng(0))
        for hand, key in enumerate(hands):
            held.begin(hand, key)
        held.begin_pelvis(*pelvis)
        held.trunk(*trunk, 0.01)
        held.gaze(*gaze, 0.01)
        if clear(held.clip("pose", np.array([0.0, 2.0, 4.0]), 0.5, balance=False)):
            break
    else:
        hands, trunk, gaze, pelvis = [DOWN, DOWN], (0.0, 0.0, 0.0), (0.0, 0.0), (0.0, 0.0, 0.0)
    seconds = max(score.reach_time(hand, key) for hand, key in enumerate(hands))
    seconds = max(seconds * float(rng.uniform(0.85, 1.4)), 0.7 * score.pace)
    for hand, key in enumerate(hands):
        score.hand(hand, key, seconds)
    score.trunk(*trunk, seconds)
    score.gaze(*gaze, seconds / score.pace)
    score.pelvis(*pelvis, seconds)
    score.wait(seconds + float(rng.uniform(*_HOLD_S)) * score.pace)


def _hand(rng: np.random.Generator) -> Hand:
    """A wrist anywhere a left arm reaches: before, beside, above, across and a little behind."""
    while True:
        way = rng.normal(size=3)
        way /= np.linalg.norm(way)
        behind, inward = way[0] < -0.35, way[1] < -0.6
        if not (behind or inward or (way[0] < 0.15 and way[1] < -0.1)):
            break
    low, high = _ARM_M
    wrist = way * rng.uniform(low, high)  # bent elbows as often as straight ones
    return Hand(
        (float(wrist[0]), float(wrist[1]), float(wrist[2])),
        pronation=float(rng.uniform(-0.9, 1.3)),
        bend=float(rng.uniform(-0.7, 0.7)),
        swivel=float(rng.uniform(-0.2, 0.7)),
    )


def _around(rng: np.random.Generator, most: float, size: float) -> float:
    return float(np.clip(rng.normal(0.0, 0.5), -1.0, 1.0)) * most * size


def _within(rng: np.random.Generator, limits: tuple[float, float], size: float) -> float:
    return float(rng.triangular(limits[0], 0.05, limits[1])) * size


def clear(clip: Clip, frame: int = -1) -> bool:
    """Whether the forearms and hands of a canonical clip pass through neither trunk, head nor
    each other in a frame."""
    p, up = clip.positions[frame], clip.rotations[frame, INDEX["head"], :, 2]
    head = p[INDEX["head"]] + _HEAD[0] * up
    arms = []
    for s in ("l_", "r_"):
        elbow, wrist = p[INDEX[s + "forearm"]], p[INDEX[s + "hand"]]
        fingers = wrist + 0.5 * (wrist - elbow) * 0.6
        arm = np.linspace(elbow, fingers, 8)[2:]
        for a, b, radius in _TORSO:
            if _distance(arm, p[INDEX[a]], p[INDEX[b]]).min() < radius + _ARM_RADIUS:
                return False
        if np.linalg.norm(arm - head, axis=1).min() < _HEAD[1] + _ARM_RADIUS:
            return False
        arms.append(arm)
    apart = np.linalg.norm(arms[0][:, None] - arms[1][None], axis=-1)
    return bool(apart.min() > 2 * _ARM_RADIUS)


def _distance(
    points: Float[Array, "N 3"], a: Float[Array, "3"], b: Float[Array, "3"]
) -> Float[Array, "N"]:
    """Of points from a line segment, metres."""
    along = b - a
    share = np.clip((points - a) @ along / (along @ along), 0.0, 1.0)
    return np.linalg.norm(points - a - share[:, None] * along, axis=1)
