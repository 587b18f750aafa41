"""Multi-start refinement: keeps, per limb, the segments of lower energy of several solutions.

A forearm seen by one view may point towards the camera or away from it, and robust terms treat the
frames that contradict a wrong choice as outliers. The other solutions start from the same motion
with a wider robust scale, and from the mean posture.

Source: Blake & Zisserman 1987, "Visual Reconstruction" (graduated non-convexity); Barron 2019, "A
general and adaptive robust loss function", section 3, for widening a robust scale.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.labels import LABEL_INDEX
from egocap.body.skeleton import DOF_COUNT, LABEL_POINTS, MOVES
from egocap.pose.config import TrackerConfig
from egocap.pose.kernel import Model
from egocap.pose.observations import Observations
from egocap.series import runs
from egocap.track.smoother import interval_system, smooth_interval

_NEAR, _FAR = (10.0, 3.0, 1.0), (30.0, 10.0, 3.0, 1.0)
"""Factors on the robust scale, one solution after another: from the motion, from the posture."""
_SAME = 0.01  # radians
_MAX_GAP = 3  # frames between segments that count as one
_MIN_GAIN = 3.0  # energy


def _limbs() -> tuple[Bool[Array, "37"], ...]:
    """All angles, those of each limb, and those of trunk and head."""
    ends = [LABEL_POINTS[LABEL_INDEX[f"{side}_{end}"]]
            for end in ("hand", "foot") for side in ("left", "right")]  # fmt: skip
    alone = [MOVES[end] & ~MOVES[[e for e in ends if e != end]].any(0) for end in ends]
    return np.ones(DOF_COUNT, bool), *alone, ~np.any(alone, axis=0)


LIMBS = _limbs()


def solve_multistart(
    angles: Float[Array, "T 37"], observations: Observations, model: Model, config: TrackerConfig,
    on_solved: Callable[[], None] = lambda: None,
) -> tuple[Float[Array, "T 37"], Bool[Array, "T"]]:  # fmt: skip
    """A motion of no more energy, and the frames in which it differs.

    `on_solved` is called after every other solution.
    """
    posture = np.repeat(model.posture_mean[None], len(angles), axis=0)
    best = angles
    for start, factors in ((angles, _NEAR), (posture, _FAR)):
        other = start
        for factor in factors:
            wide = replace(config, robust_scale=factor * config.robust_scale)
            other, _ = smooth_interval(other, observations, model, wide)
            on_solved()
        best = merge_segments(best, other, observations, model, config)
    return best, changed_frames(angles, best)


def changed_frames(angles: Float[Array, "T 37"], other: Float[Array, "T 37"]) -> Bool[Array, "T"]:
    """Frames in which two motions differ."""
    return np.abs(angles - other).max(axis=1) > _SAME


def merge_segments(
    angles: Float[Array, "T 37"], other: Float[Array, "T 37"], observations: Observations,
    model: Model, config: TrackerConfig,
) -> Float[Array, "T 37"]:  # fmt: skip
    """This motion, with those segments of another's limbs that lower the energy."""
    best = angles
    for limb in LIMBS:
        for segment in _segments(np.abs(best - other)[:, limb].max(axis=1) > _SAME):
            trial = best.copy()
            trial[segment, limb] = other[segment, limb]
            # Accelerations reach two frames beyond.
            near = slice(max(segment.start - 2, 0), segment.stop + 2)
            known = observations[near], model, config
            if interval_system(trial[near], *known)[0] < (
                interval_system(best[near], *known)[0] - _MIN_GAIN
            ):
                best = trial
    return best


def _segments(apart: Bool[Array, "T"]) -> Iterator[slice]:
    for run in runs(np.flatnonzero(apart), _MAX_GAP):
        yield slice(int(run[0]), int(run[-1]) + 1)
