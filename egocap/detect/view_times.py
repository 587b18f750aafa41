"""Detections of cameras that do not expose together, moved to the times of the frames.

A view's picture may be half a frame away from its frame's time. A point is moved along the line to
its detection in the view's picture on the other side of that time.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int64
from numpy import ndarray as Array

from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.data.footage import FrameTimes

_EXACT_S = 5e-4  # from a frame's time within which nothing is moved
_FASTEST = 2.0  # image widths a second: what is faster is no motion but another detection
_LONGEST_S = 0.1  # between the two pictures


def at_frame_times(found: Detections, times: FrameTimes, rig: Rig) -> Detections:
    """Detections at the times of the frames, where a neighbouring picture tells the motion.

    `found` and `times` have the same frames.
    """
    if (np.abs(times.taken - times.time[:, None])[times.present] < _EXACT_S).all():
        return found
    points = found.points.copy()
    modes = None if found.modes is None else found.modes.copy()
    for v, camera in enumerate(rig.cameras):
        move = _moves(found.points[:, v], found.valid[:, v], times, v, camera.width)
        points[:, v] += move
        if modes is not None:
            modes[:, v] += move[:, :, None]
    return replace(found, points=points, modes=modes)


def _moves(
    points: Float[Array, "T 18 2"], valid: Bool[Array, "T 18"], times: FrameTimes, v: int,
    width: int,
) -> Float[Array, "T 18 2"]:  # fmt: skip
    """How far each point of a view moves from its picture's time to its frame's."""
    T, taken, present = len(times.time), times.taken[:, v], times.present[:, v]
    late = times.time - taken  # s, of the frame behind its picture
    other = _neighbours(present, np.where(late > 0.0, 1, -1))
    has = present & (other >= 0) & (other < T) & (np.abs(late) >= _EXACT_S)
    other = np.clip(other, 0, T - 1)
    apart = np.where(has, taken[other] - taken, 1.0)
    has &= (np.abs(apart) <= _LONGEST_S) & (apart != 0.0)
    usable = has[:, None] & valid & valid[other]
    speed = np.where(usable[..., None], points[other] - points, 0.0) / apart[:, None, None]
    plausible = np.linalg.norm(speed, axis=-1, keepdims=True) < _FASTEST * width
    return np.where(plausible, speed * late[:, None, None], 0.0)


def _neighbours(present: Bool[Array, "T"], towards: Int64[Array, "T"]) -> Int64[Array, "T"]:
    """The next frame with a picture, after (1) or before (-1) each; beyond the ends: none."""
    T = len(present)
    rows = np.arange(T)
    ahead = np.where(present, rows, T)
    after = np.append(np.minimum.accumulate(ahead[::-1])[::-1], T)[1:]
    before = np.concatenate([[-1], np.maximum.accumulate(np.where(present, rows, -1))])[:-1]
    return np.where(towards > 0, after, before)
