"""Random hand positions: anywhere within reach, or touching the body or the floor."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.geometry import unit
from egocap_sim.core.bodies import INDEX
from egocap_sim.motion.generators.keyframes import DOWN, Hand
from egocap_sim.motion.generators.whole_pose import WholePose, pose_clip
from egocap_sim.motion.kinematics import figure
from egocap_sim.motion.kinematics.clearance import clearance, palms
from egocap_sim.motion.kinematics.clip import Clip

Rng = np.random.Generator
Spot = tuple[Float[Array, "3"], Float[Array, "3"]]  # a point of the skin and its outward normal

DRAWS = 48  # candidates for both hands; the best is taken
_SPOTS = 8  # at most, until one is within reach
_ARM_M = (0.15, 0.535)  # of the wrist from the shoulder
_PALM_M = 0.11  # from a touched spot to the wrist
_MISS_M = 0.12  # a palm farther from its spot than this does not touch it
_DEEPEST_M = -0.005  # least clearance: a hand may press into what it touches


def _frame(clip: Clip, body: str) -> tuple[Array, Array]:
    return clip.positions[0, INDEX[body]], clip.rotations[0, INDEX[body]]


def _head_spot(x: float, y: float, z: float, rng: Rng, sign: float) -> Callable[[Clip], Spot]:
    """A spot on the head, in head radii from its centre; y is outward on the hand's side."""
    way = unit(np.array([x, sign * y, z]) + rng.normal(0.0, 0.12, 3))

    def spot(clip: Clip) -> Spot:
        p, R = _frame(clip, "head")
        return p + R @ (np.array([0.02, 0.0, 0.12]) + 0.125 * way), R @ way

    return spot


def _bone_spot(
    a: str, b: str, share: float, thick: float, way: tuple[float, float, float], sign: float
) -> Callable[[Clip], Spot]:
    """A spot on the skin between two joints, on the side `way` of the first body's frame."""

    def spot(clip: Clip) -> Spot:
        (p, R), (q, _) = _frame(clip, a), _frame(clip, b)
        out = R @ unit(np.array([way[0], sign * way[1], way[2]]))
        return p + share * (q - p) + thick * out, out

    return spot


def _floor_spot(ahead: float, aside: float, sign: float, side: str) -> Callable[[Clip], Spot]:
    """A spot on the floor, relative to the toes on the hand's side."""

    def spot(clip: Clip) -> Spot:
        p, R = _frame(clip, side + "toe")
        way = unit(R[:, 0] * [1.0, 1.0, 0.0])
        left = np.array([-way[1], way[0], 0.0])
        return (p + ahead * way + sign * aside * left) * [1, 1, 0], np.array([0.0, 0.0, 1.0])

    return spot


def _upper_body_spot(rng: Rng, s: str, o: str, sign: float) -> Callable[[Clip], Spot]:
    """On the head, the trunk or the other arm."""
    spots = (
        lambda: _head_spot(1.0, 0.25, -0.5, rng, sign),  # mouth, chin
        lambda: _head_spot(0.8, 0.75, 0.0, rng, sign),  # cheek, eye
        lambda: _head_spot(0.7, 0.4, 0.8, rng, sign),  # forehead
        lambda: _head_spot(-0.9, 0.5, 0.1, rng, sign),  # behind the head
        lambda: _head_spot(0.1, 1.0, 0.1, rng, sign),  # ear
        lambda: _bone_spot(o + "upperarm", o + "forearm", float(rng.uniform(0.1, 0.9)), 0.06,
                       (0.7, -0.7, 0.0), sign),
        lambda: _bone_spot(o + "forearm", o + "hand", float(rng.uniform(0.2, 1.0)), 0.05,
                       (0.7, -0.3, 0.3), sign),
        lambda: _bone_spot("chest", "neck", rng.uniform(0.0, 0.8), 0.13, (1.0, 0.2, 0.0), sign),
        lambda: _bone_spot("pelvis", "chest", rng.uniform(0.0, 0.7), 0.15, (1.0, 0.2, 0.0), sign),
        lambda: _bone_spot("pelvis", "chest", rng.uniform(0.1, 0.4), 0.16, (0.1, 1.0, 0.0), sign),
        lambda: _bone_spot("pelvis", "chest", rng.uniform(0.1, 0.6), 0.13, (-1.0, 0.3, 0.0), sign),
    )  # fmt: skip
    return spots[int(rng.integers(len(spots)))]()


def _lower_body_spot(rng: Rng, s: str, o: str, sign: float) -> Callable[[Clip], Spot]:
    """On a leg, a foot or the floor beside it."""
    leg = s if rng.random() < 0.75 else o
    spots = (
        lambda: _bone_spot(leg + "thigh", leg + "calf", float(rng.uniform(0.4, 1.0)), 0.08,
                       (0.9, 0.4, 0.0), sign),
        lambda: _bone_spot(leg + "calf", leg + "foot", float(rng.uniform(0.0, 0.9)), 0.055,
                       (0.7, 0.7, 0.0), sign),
        lambda: _bone_spot(leg + "foot", leg + "toe", float(rng.uniform(0.0, 1.0)), 0.05,
                       (0.1, 0.7, 0.7), sign),
        lambda: _floor_spot(float(rng.uniform(-0.15, 0.4)), float(rng.uniform(-0.05, 0.3)),
                            sign, s),
        lambda: _floor_spot(float(rng.uniform(-0.05, 0.5)), float(rng.uniform(0.0, 0.15)),
                            sign, s),
    )  # fmt: skip
    return spots[int(rng.integers(len(spots)))]()


def sample_hands(rng: Rng, pose: WholePose, touches: float, low: float) -> WholePose | None:
    """The pose with sampled hands; None if every candidate penetrates the body.

    A hand touches something with probability `touches`, then legs or floor with probability `low`.
    """
    rows = np.stack([np.array([_random_hand(rng).row for _ in range(DRAWS)]) for _ in range(2)], 1)
    bare = pose_clip(pose)
    spots: list[Spot | None] = [None, None]
    for i, (s, o, sign) in enumerate((("l_", "r_", 1.0), ("r_", "l_", -1.0))):
        if rng.random() < touches:
            pick = _lower_body_spot if rng.random() < low else _upper_body_spot
            tried = (pick(rng, s, o, sign)(bare) for _ in range(_SPOTS))
            spots[i] = next((x for x in tried if _within_reach(bare, s, sign, x[0])), None)
            if (spot := spots[i]) is not None:
                rows[:, i] = _hands_near(rng, bare, i, spot)
    clip = pose_clip(pose, rows)
    free = clearance(clip)
    cost = np.where(free > _DEEPEST_M, 0.0, 1.0 - free)
    middle, facing = palms(clip)
    for i, spot in enumerate(spots):
        if spot is not None:
            miss = np.linalg.norm(middle[:, i] - spot[0], axis=-1)
            cost += (
                miss + 0.03 * (1.0 + facing[:, i] @ spot[1]) + np.where(miss > _MISS_M, 0.2, 0.0)
            )
    best = int(cost.argmin())
    if free[best] <= _DEEPEST_M:
        return None
    hands = tuple(
        Hand((float(x), float(y), float(z)), *map(float, turns)) for x, y, z, *turns in rows[best]
    )
    return replace(pose, hands=hands)


def _random_hand(rng: Rng) -> Hand:
    """A random hand within the reach of a left arm."""
    if rng.random() < 0.08:
        return DOWN
    while True:
        way = rng.normal(size=3)
        way /= math.sqrt(way @ way)
        behind, inward = way[0] < -0.35, way[1] < -0.6
        if not (behind or inward or (way[0] < 0.15 and way[1] < -0.1)):
            break
    wrist = way * rng.uniform(*_ARM_M)  # bent elbows as often as straight ones
    return Hand(
        (float(wrist[0]), float(wrist[1]), float(wrist[2])),
        pronation=float(rng.uniform(-0.9, 1.3)),
        bend=float(rng.uniform(-0.7, 0.7)),
        swivel=float(rng.uniform(-0.2, 0.7)),
    )


def _shoulder(clip: Clip, side: str) -> tuple[Array, Array]:
    """Origin of the hands' coordinates, world, and the chest's rotation."""
    p, R = _frame(clip, "chest")
    return p + R @ figure.offset(side + "upperarm", "chest"), R


def _within_reach(clip: Clip, side: str, sign: float, spot: Float[Array, "3"]) -> bool:
    at, R = _shoulder(clip, side)
    local = R.T @ (spot - at) * [1.0, sign, 1.0]
    across = local[1] < -0.35 or (local[0] < -0.05 and local[1] < -0.1 and local[2] < 0.05)
    return bool(0.12 < np.linalg.norm(local) < 0.66 and not across)


def _hands_near(rng: Rng, clip: Clip, hand: int, spot: Spot) -> Float[Array, "N 6"]:
    """Candidates for a hand at a spot: the wrist lies outward and towards the shoulder."""
    side, sign = ("l_", 1.0) if hand == 0 else ("r_", -1.0)
    at, R = _shoulder(clip, side)
    point, out = spot
    way = unit(out + 0.9 * unit(at - point) + rng.normal(0.0, 0.6, (DRAWS, 3)))
    wrist = point + _PALM_M * rng.uniform(0.75, 1.15, (DRAWS, 1)) * way
    local = (wrist - at) @ R * [1.0, sign, 1.0]
    turned = rng.uniform((-0.9, -0.7, -0.3), (1.3, 0.7, 0.9), (DRAWS, 3))
    return np.concatenate([local, turned], 1)
