"""Pictures of all views together, instant by instant: as they come, or as recorded.

`LiveFeed` takes the newest pictures of running sources. `RecordedFeed` takes every frame of video
files at the time that its file states.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import chain, pairwise
from typing import Protocol

from jaxtyping import UInt8
from numpy import ndarray as Array

from egocap.errors import InputError
from egocap.media.video import open_video
from egocap.view.capture import CameraSettings, Picture, Source

_PATIENCE_S = 5.0  # without a picture of the first view before it counts as gone
_STRAGGLER_S = 0.1

Images = Sequence[UInt8[Array, "H W 3"] | None]
"""RGB pictures, one a view; None where one is missing."""


@dataclass(frozen=True, eq=False)
class Instant:
    """The pictures of one instant."""

    time: float  # s
    images: Images
    taken: float  # s, `time.monotonic`: when the oldest picture came
    late: tuple[float, ...]  # s from `time` to each picture; 0 for a missing one

    @property
    def skew(self) -> float:
        """Seconds between the pictures."""
        return max(self.late) - min(self.late)


class Feed(Protocol):
    """What is tracked."""

    @property
    def skipped(self) -> int:
        """Pictures that a newer one replaced."""
        ...

    def __iter__(self) -> Iterator[Instant]: ...


class LiveFeed:
    """The newest picture of every source, at least one of them new, until all have ended."""

    def __init__(
        self, sources: Sequence[Source], seconds: float = float("inf"),
        stopped: Callable[[], bool] = lambda: False,
    ) -> None:  # fmt: skip
        self.sources, self.seconds, self.stopped = sources, seconds, stopped
        self._missing = [False] * len(sources)

    @property
    def skipped(self) -> int:
        """Pictures that a newer one replaced."""
        return sum(source.skipped for source in self.sources)

    def __iter__(self) -> Iterator[Instant]:
        end, last = time.monotonic() + self.seconds, -float("inf")
        while time.monotonic() < end and not self.stopped():
            if all(source.exhausted for source in self.sources):
                return
            pictures = self._newest()
            taken = [p.taken for p in pictures if p is not None]
            if taken and max(taken) > last:  # else a straggler: the other view is further on
                last = max(taken)
                images = [None if p is None else p.image for p in pictures]
                late = tuple(0.0 if p is None else p.taken - last for p in pictures)
                yield Instant(last, images, min(taken), late)

    def _newest(self) -> list[Picture | None]:
        """Views that had no picture the last time are not waited for, unless none had one."""
        patience = _PATIENCE_S
        pictures: list[Picture | None] = []
        for source, gone in zip(self.sources, self._missing, strict=True):
            pictures.append(source.newest(0.0 if gone else patience))
            patience = patience if gone else _STRAGGLER_S
        missing = [picture is None for picture in pictures]
        self._missing = [gone and not all(missing) for gone in missing]
        return pictures


class RecordedFeed:
    """Every frame of the first video, with the frames of the others that are nearest in time.

    Raises FileError for a file that is no video.
    """

    skipped = 0

    def __init__(
        self, paths: Sequence[str], seconds: float = float("inf"),
        stopped: Callable[[], bool] = lambda: False,
    ) -> None:  # fmt: skip
        self._videos = [open_video(path) for path in paths]
        self.seconds, self.stopped = seconds, stopped

    def __iter__(self) -> Iterator[Instant]:
        first, *others = self._videos
        followed = [_Nearest(video.frames()) for video in others]
        start: float | None = None
        for shown, following in pairwise(chain(first.frames(), [None])):
            assert shown is not None
            when, image = shown
            start = when if start is None else start
            if when - start > self.seconds or self.stopped():
                return
            came = time.monotonic()
            until = float("inf") if following is None else (when + following[0]) / 2.0
            beside = [other.at(when, until) for other in followed]
            late = 0.0, *(t - when for t, _ in beside)
            yield Instant(when, [image, *(picture for _, picture in beside)], came, late)


class _Nearest:
    """The frame nearest to times that increase; each frame is given once."""

    def __init__(self, frames: Iterator[tuple[float, UInt8[Array, "H W 3"]]]) -> None:
        self._frames = frames
        self._ahead = next(frames, None)

    def at(self, when: float, until: float) -> tuple[float, UInt8[Array, "H W 3"] | None]:
        """Time and picture of the frame nearest to `when`; later than `until` is the next one's.

        The picture is None where no frame is near.
        """
        best = None
        while self._ahead is not None and self._ahead[0] < until:
            if best is None or abs(self._ahead[0] - when) < abs(best[0] - when):
                best = self._ahead
            self._ahead = next(self._frames, None)
        return (when, None) if best is None or abs(best[0] - when) > _STRAGGLER_S else best


def open_feed(
    stack: ExitStack, names: Sequence[str], cameras: CameraSettings,
    stopped: Callable[[], bool], seconds: float = float("inf"), *, realtime: bool = False,
) -> Feed:  # fmt: skip
    """Every frame of files, or sources that start to run now and are closed with the stack.

    `realtime`: files run by the clock, as cameras do.
    """
    if recorded(names, realtime=realtime):
        return RecordedFeed(names, seconds, stopped)
    found, start = [], time.monotonic()
    for name in names:
        found.append(Source(name, cameras, start))
        stack.callback(found[-1].close)
    return LiveFeed(found, seconds, stopped)


def recorded(names: Sequence[str], *, realtime: bool) -> bool:
    """Whether every frame of files is used, instead of the newest one."""
    return not realtime and not any(name.isdigit() for name in names)


def check_sources(names: Sequence[str], views: int) -> None:
    """Raise InputError unless there is one source for every view."""
    if len(names) != views:
        raise InputError(f"{len(names)} sources", valid=f"{views}, one per view")
    cameras = [int(name) for name in names if name.isdigit()]
    if twice := [camera for camera in cameras if cameras.count(camera) > 1]:
        raise InputError(f"camera {twice[0]} is given for more than one view",
                         valid="a camera of its own for each view; --list shows them")  # fmt: skip
