"""Measures of the feet in the world: sliding while planted, and when they are said to be planted.

Tracks are in the head frame; the caller takes them to the world, with the true head pose unless the
method estimates its own. F axis: feet, left then right; the joint is the toe (label "..._foot").
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

PLANTED_SPEED = 0.6  # m/s, below which a foot may be planted
PLANTED_HEIGHT = 0.03  # metres above the lowest toe of the last and next `WINDOW_S`
WINDOW_S = 0.5


def foot_speed(
    feet: Float[Array, "T F 3"], times: Float[Array, "T"]
) -> tuple[Float[Array, "T F"], Float[Array, "T F"]]:
    """Horizontal and whole speed of each foot, m/s, by central differences (one-sided at the ends).

    Frames may be unevenly spaced. Needs two frames or more.
    """
    velocity = np.gradient(np.asarray(feet, np.float64), np.asarray(times, np.float64), axis=0)
    return np.linalg.norm(velocity[..., :2], axis=-1), np.linalg.norm(velocity, axis=-1)


def foot_skate(
    feet: Float[Array, "T F 3"], planted: Bool[Array, "T F"], times: Float[Array, "T"]
) -> float:
    """Mean horizontal speed of the feet while they are truly planted, m/s; NaN if they never are.

    Frames count whose neighbours are planted too, so that landing and lifting are no skating.
    """
    if len(feet) < 3:
        return float("nan")
    inside = planted.copy()
    inside[1:] &= planted[:-1]
    inside[:-1] &= planted[1:]
    horizontal, _ = foot_speed(feet, times)
    return float(horizontal[inside].mean()) if inside.any() else float("nan")


def estimate_planted(feet: Float[Array, "T F 3"], times: Float[Array, "T"]) -> Bool[Array, "T F"]:
    """Feet that stand: slow, and low among the toes' heights of the second around.

    The floor's height is not asked for; on stairs fewer are found, and none while lying. On true
    joints the rule's F1 is 0.94 (a foot is planted that touches with heel or toe): report it beside
    a method's.
    """
    times = np.asarray(times, np.float64)
    _, speed = foot_speed(feet, times)
    lowest = feet[..., 2].min(-1)
    near = np.abs(times[:, None] - times) <= WINDOW_S  # (T, T)
    floor = np.where(near, lowest, np.inf).min(-1)
    return (speed <= PLANTED_SPEED) & (feet[..., 2] - floor[:, None] <= PLANTED_HEIGHT)


def f1_score(predicted: Bool[Array, "*axes"], truth: Bool[Array, "*axes"]) -> float:
    """Harmonic mean of precision and recall, 0 to 1; NaN when neither says yes anywhere."""
    total = int(predicted.sum()) + int(truth.sum())
    return 2.0 * int((predicted & truth).sum()) / total if total else float("nan")
