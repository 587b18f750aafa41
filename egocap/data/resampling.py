"""A track at even times, as animation files need them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.proportions import Proportions
from egocap.body.skeleton import forward
from egocap.data.head_pose import interpolate_poses
from egocap.data.track import Track
from egocap.errors import InputError
from egocap.geometry import transform
from egocap.series import interpolate

_ROUNDED_S = 1.01e-3
EVEN = 0.02
"""Relative difference between the longest and the shortest step of times that count as even."""
MOST_FRAMES, MOST_RATIO = 100_000, 10
"""Even times may be so many, or so many times the track's own: one wrong time makes billions."""


def typical_step(times: Float[Array, "T"]) -> float:
    """Mean of the steps near the median one [s]: a container may round times to milliseconds.

    Of two middle ones the shorter: their mean may be near none.
    """
    steps = np.diff(times)
    middle = float(np.quantile(steps, 0.5, method="lower"))
    return float(steps[np.abs(steps - middle) <= 0.1 * middle + _ROUNDED_S].mean())


def evenly(track: Track, fps: float | None = None) -> Track:
    """The track at even times, from its first to its last; the same track if it is even already.

    Angles are interpolated linearly, head poses along their rotations. `fps` is the median rate of
    the track by default. Raises InputError for times that do not increase, or that are so far
    apart that they need more frames than MOST_FRAMES and MOST_RATIO allow.
    """
    steps = np.diff(track.times)
    if not len(steps):
        return track
    if (steps <= 0).any():
        raise InputError("the track's times do not increase")
    if fps is None and np.ptp(steps) <= EVEN * steps.mean():
        return track
    step = typical_step(track.times) if fps is None else 1.0 / fps
    span, most = float(np.ptp(track.times)), max(MOST_FRAMES, MOST_RATIO * len(track.times))
    if not span / step < most:
        raise InputError(f"the track's times span {span:g} s, {span / step:.3g} even steps",
                         valid=f"at most {most:,} steps of {step:g} s")  # fmt: skip
    count = int(span / step + 1e-6) + 1
    return resampled(track, track.times[0] + step * np.arange(count))


def resampled(track: Track, times: Float[Array, "N"]) -> Track:
    """The track at other times within its own; what has no between is the nearest frame's."""
    nearest = np.rint(np.interp(times, track.times, np.arange(len(track.times)))).astype(int)
    arrays = {name: value[nearest] for name, value in track.by_frame.items()}
    angles = interpolate(times, track.times, track.angles)
    arrays |= {"times": times, "angles": angles}
    if track.offsets is not None:
        arrays["joints_head"] = forward(Proportions(track.offsets), angles)
    if track.T_world_head is not None:
        arrays["T_world_head"] = interpolate_poses(times, track.times, track.T_world_head)
        arrays["joints_world"] = transform(arrays["T_world_head"], arrays["joints_head"])
    return replace(track, **arrays)
