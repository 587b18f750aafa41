"""Cheaper motions than the one that was found, sought from elsewhere and taken limb by limb.

Seen by one view, a forearm may point towards the camera or away; taken for the wrong one of the
two it stays there, past frames that contradict it, for robust terms give these up. So the whole
motion is solved again: from where it is, with errors that pull from farther away at first, and from
the everyday posture, where nothing of it is left. Of what comes out, every limb's stretches are
taken where they lower the energy.

Source: Blake & Zisserman 1987, "Visual Reconstruction" (graduated non-convexity); Barron 2019, "A
general and adaptive robust loss function", section 3, for widening a robust scale.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.labels import LABEL_INDEX
from egocap.body.skeleton import DOF_COUNT, LABEL_POINTS, MOVES
from egocap.pose.config import TrackerConfig
from egocap.pose.kernel import Model
from egocap.pose.observations import Observations
from egocap.track.smoother import interval_system, smooth_interval

_NEAR, _FAR = (10.0, 3.0), (30.0, 10.0, 3.0)
"""Factors on the robust scale, one solution after another: from the motion, from the posture."""
_SAME = 0.01  # radians
_GAP = 3  # frames: stretches so close are one
_LEAST = 3.0  # energy that a stretch must save: less tells nothing


def _limbs() -> tuple[Bool[Array, "37"], ...]:
    """The angles of each limb, of the trunk and head, and all."""
    ends = [LABEL_POINTS[LABEL_INDEX[f"{side}_{end}"]]
            for end in ("hand", "foot") for side in ("left", "right")]  # fmt: skip
    alone = [MOVES[end] & ~MOVES[[e for e in ends if e != end]].any(0) for end in ends]
    return np.ones(DOF_COUNT, bool), *alone, ~np.any(alone, axis=0)


LIMBS = _limbs()


def restarted(
    angles: Float[Array, "T 37"], observations: Observations, model: Model, config: TrackerConfig
) -> tuple[Float[Array, "T 37"], Bool[Array, "T"]]:
    """A motion of no more energy, all frames together, and which of its frames are others."""
    everyday = np.repeat(model.posture_mean[None], len(angles), axis=0)
    best = angles
    for start, widenings in ((angles, _NEAR), (everyday, _FAR)):
        other = start
        for widening in (*widenings, 1.0):
            wide = replace(config, robust_scale=widening * config.robust_scale)
            other, _ = smooth_interval(other, observations, model, wide)
        best = spliced(best, other, observations, model, config)
    return best, moved(angles, best)


def moved(angles: Float[Array, "T 37"], other: Float[Array, "T 37"]) -> Bool[Array, "T"]:
    """Frames in which two motions differ."""
    return np.abs(angles - other).max(axis=1) > _SAME


def spliced(
    angles: Float[Array, "T 37"], other: Float[Array, "T 37"], observations: Observations,
    model: Model, config: TrackerConfig,
) -> Float[Array, "T 37"]:  # fmt: skip
    """The stretches of another motion that lower the energy, limb by limb, in this one."""
    best = angles
    for limb in LIMBS:
        for stretch in _stretches(np.abs(best - other)[:, limb].max(axis=1) > _SAME):
            trial = best.copy()
            trial[stretch, limb] = other[stretch, limb]
            # Accelerations reach two frames beyond.
            near = slice(max(stretch.start - 2, 0), stretch.stop + 2)
            known = observations[near], model, config
            if interval_system(trial[near], *known)[0] < (
                interval_system(best[near], *known)[0] - _LEAST
            ):
                best = trial
    return best


def _stretches(apart: Bool[Array, "T"]) -> Iterator[slice]:
    frames = np.flatnonzero(apart)
    if len(frames):
        for run in np.split(frames, np.flatnonzero(np.diff(frames) > _GAP) + 1):
            yield slice(int(run[0]), int(run[-1]) + 1)
