"""The joints of a track as labelled points, for formats of marker data and tables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.labels import LABELS
from egocap.data.resampling import EVEN, evenly
from egocap.data.track import Track


@dataclass(frozen=True, eq=False)
class Markers:
    """Labelled points over time."""

    names: tuple[str, ...]
    points: Float[Array, "T N 3"]  # metres, our axes; NaN where a point is not known
    times: Float[Array, "T"]
    fps: float
    frame: Literal["world", "head"]


def joint_markers(track: Track) -> Markers:
    """The 18 joints, in the world if the head pose is known, at even times."""
    even = evenly(track)
    steps = np.diff(even.times)
    assert not len(steps) or np.ptp(steps) <= EVEN * steps.mean()
    points, frame = joints_known(even)
    fps = 1.0 / float(steps.mean()) if len(steps) else 30.0
    return Markers(LABELS, points, even.times, fps, frame)


def joints_known(track: Track) -> tuple[Float[Array, "T 18 3"], Literal["world", "head"]]:
    """Joints in the world if the head pose is known, NaN where it has a gap; else in the head."""
    if track.joints_world is None:
        return track.joints_head, "head"
    if track.in_world is None:
        return track.joints_world, "world"
    return np.where(track.in_world[:, None, None], track.joints_world, np.nan), "world"
