"""What is wrong with a rig file, told by the surroundings in a recording of the rig.

The odometry follows pictures that move with wide tolerances; the rig that explains them best is
compared with the file. Where something is found, two passes with that rig are narrower.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future
from dataclasses import replace
from itertools import takewhile
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.cameras.rig import Rig
from egocap.data.sequence import Sequence
from egocap.head_pose.pictures import Grey, grey_frames
from egocap.head_pose.wearer import WearerMasks
from egocap.odometry.config import OdometryConfig
from egocap.odometry.odometry import Odometry, are_apart
from egocap.odometry.self_calibration import (
    KEYFRAMES,
    NOISES_PX,
    Correction,
    RigSearch,
    find_correction,
)
from egocap.odometry.track_map import Posed
from egocap.odometry.views import Views

RATE_HZ = 16.0
"""Most frames a second in which errors of a rig are sought, unless the head moves much: half of
30 Hz."""
LONGEST_S = 15.0
"""Time in which keyframes are sought."""

Masks = tuple[Bool[Array, "h w"] | None, ...]
Added = tuple[int, float, tuple[Grey | None, ...], Masks, Float[Array, "V"] | None]
"""A frame as `Odometry.add` takes it."""


def find_rig_correction(
    sequence: Sequence,
    views: Views,
    config: OdometryConfig = OdometryConfig(),  # noqa: B008 (frozen)
    wearer: WearerMasks | None = None,
) -> Correction | None:
    """The correction of the views of a sequence; None where nothing is found to be wrong."""
    return search_rig(sequence, views, config, wearer).correction


def search_rig(
    sequence: Sequence,
    views: Views,
    config: OdometryConfig = OdometryConfig(),  # noqa: B008 (frozen)
    wearer: WearerMasks | None = None,
) -> RigSearch:
    """What is wrong with the views of a sequence, and what remains unknown of them."""
    times = sequence.times
    every = np.flatnonzero(times <= times[0] + LONGEST_S).tolist()
    some = every[:1]
    for row in every:
        if _due(times[row], times[some[-1]]):
            some.append(row)

    def frames(moves: bool) -> Iterable[Added]:
        return frames_of(sequence, views.rig, every if moves else some, wearer)

    return search_frames(frames, views, config)


def search_frames(
    frames: Callable[[bool], Iterable[Added]], views: Views, config: OdometryConfig
) -> RigSearch:
    """The same from the `frames` of a pass, given whether the head moves much by the one before."""
    found, moves = RigSearch.fruitless(views), False
    for noise_px in NOISES_PX:
        now = views if found.correction is None else found.correction.views
        odometry = Odometry(now, replace(config, noise_px=noise_px))
        for frame in frames(moves):
            odometry.add(*frame)
            if moves := len(odometry.map.keyframes) >= KEYFRAMES:
                break
        found = find_correction(odometry.map, views, found.correction)
        if found.correction is None:
            break
    return found


class OnlineCorrection:
    """Corrects views once, from the pictures of a live run, when its head has moved enough.

    `waits`: for the search; else it is made by `beside` while pictures go on.
    """

    def __init__(
        self, views: Views, config: OdometryConfig, beside: Executor, *, waits: bool
    ) -> None:
        self.done = not config.self_calibration
        self._views, self._config, self._beside, self._waits = views, config, beside, waits
        self._frames: deque[Added] = deque(maxlen=int(LONGEST_S * RATE_HZ))
        self._apart: list[Posed] = []
        self._search: Future[RigSearch] | None = None

    def add(self, frame: Added, pose: Posed) -> Correction | None:
        """Take the next frame and its pose.

        Returns a correction once; None where there is none yet, or nothing is found to be wrong.
        """
        if self.done:
            return None
        if self._search is None:
            last = self._apart[-1] if self._apart else None
            if last is None or last.segment != pose.segment or are_apart(last, pose, self._config):
                self._apart.append(pose)
            if not self._frames or _due(frame[1], self._frames[-1][1]):
                self._frames.append(frame)
            if len(self._apart) < KEYFRAMES:
                return None
            frames = tuple(self._frames)
            self._search = self._beside.submit(
                search_frames, lambda _: takewhile(lambda _: not self.done, frames),
                self._views, self._config,
            )  # fmt: skip
            self._frames.clear()
            self._apart.clear()
        if not (self._waits or self._search.done()):
            return None
        found, self.done, self._search = self._search.result(), True, None
        return found.correction

    def close(self) -> None:
        """End a search that is under way, soon."""
        self.done = True


def _due(time: float, last: float) -> bool:
    return time - last >= 1.0 / RATE_HZ


def frames_of(
    sequence: Sequence, rig: Rig, rows: Iterable[int], wearer: WearerMasks | None
) -> Iterator[Added]:
    """Frames of a sequence, their pictures at the size of `rig`."""
    for row, images in grey_frames(sequence, rig, rows):
        time = float(sequence.times[row])
        masks = () if wearer is None else wearer.at(time)
        yield row, time, images, masks, _late(sequence, row)


def _late(sequence: Sequence, index: int) -> Float[Array, "V"] | None:
    """Seconds from a frame's time to its pictures; None where they are of one instant."""
    times = sequence.frame_times
    if times is None:
        return None
    return np.where(times.present[index], times.taken[index] - times.time[index], 0.0)


def correction_lines(facts: dict[str, Any]) -> list[str]:
    """`Correction.facts` in words, a line for each view."""
    return [
        f"{view} corrected: turned by {found['rotation_deg']:.2f} degrees, moved by "
        f"{found['translation_mm']:.1f} mm, focal length {found['focal_percent']:+.2f} %, centre "
        f"by {found['centre_px']:.1f} px; lag {found['lag_ms']:.1f} ms, first to last row "
        f"{found['readout_ms']:.1f} ms"
        for view, found in facts.items()
    ]
