"""Live tracking from cameras or video files, each at its own pace.

Every source is read by a thread of its own into a slot that holds one picture: a newer one takes
the place of one that nobody fetched, so that a slow tracker skips frames and never falls behind.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from egocap.body.proportions import Proportions
from egocap.data.detections import Detections
from egocap.data.track import Track
from egocap.errors import InputError, MachineError
from egocap.track.online import OnlineTracker, PoseEstimate

if TYPE_CHECKING:
    import cv2

_PATIENCE_S = 5.0  # without a picture of some view before it counts as gone


class KnowsPerson(Protocol):
    """What `OnlineTracker` and `ColourTracker` have in common here."""

    proportions: Proportions


class DetectsOne(Protocol):
    """What `egocap.detect.detector.Detector` offers for one instant."""

    def detect_images(self, images: Sequence[Array | None], time: float = 0.0) -> Detections:
        """Detections (T = 1) in one picture a view, None where one is missing."""
        ...


@dataclass(frozen=True, eq=False)
class Picture:
    """One picture and when it was taken."""

    image: UInt8[Array, "H W 3"]  # RGB
    taken: float  # s, `time.monotonic`


class Source:
    """A camera or a video file, read at its own pace; holds the newest picture only."""

    def __init__(self, name: str) -> None:
        import cv2

        self.name = name
        self._video = _opened(name)
        rate = float(self._video.get(cv2.CAP_PROP_FPS))
        # A camera keeps its own pace; a file has none but its rate.
        self._period = 0.0 if name.isdigit() else 1.0 / (rate if rate > 0.0 else 30.0)
        self._fresh = threading.Condition()
        self._picture: Picture | None = None
        self.ended, self.taken, self.skipped = False, 0, 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._read, name=f"source {name}", daemon=True)
        self._thread.start()

    def newest(self, timeout: float) -> Picture | None:
        """The newest picture nobody fetched; None when the source has ended or nothing came."""
        with self._fresh:
            self._fresh.wait_for(lambda: self._picture is not None or self.ended, timeout)
            picture, self._picture = self._picture, None
            return picture

    @property
    def exhausted(self) -> bool:
        """Whether it has ended and its last picture was fetched."""
        with self._fresh:
            return self.ended and self._picture is None

    def close(self) -> None:
        """Stop reading."""
        self._stop.set()
        self._thread.join()
        self._video.release()

    def _read(self) -> None:
        import cv2

        start, count = time.monotonic(), 0
        while not self._stop.is_set():
            there, image = self._video.read()
            if not there:
                break
            count += 1
            wait = start + count * self._period - time.monotonic()
            if self._period and wait > 0.0:
                self._stop.wait(wait)
            self._put(Picture(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), time.monotonic()))
        with self._fresh:
            self.ended = True
            self._fresh.notify_all()

    def _put(self, picture: Picture) -> None:
        with self._fresh:
            self.skipped += self._picture is not None
            self.taken += 1
            self._picture = picture
            self._fresh.notify_all()


def first_pictures(names: Sequence[str]) -> list[UInt8[Array, "H W 3"]]:
    """What cameras or the beginnings of video files show now, RGB.

    Raises InputError for one that cannot be opened or has no picture.
    """
    import cv2

    found = []
    for name in names:
        video = _opened(name)
        there, image = video.read()
        video.release()
        if not there:
            raise InputError(f"no picture in '{name}'", valid="a video file or a camera's number")
        found.append(cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
    return found


def _opened(name: str) -> cv2.VideoCapture:
    import cv2

    video = cv2.VideoCapture(int(name) if name.isdigit() else name)
    if not video.isOpened():
        raise InputError(f"cannot open '{name}'", valid="a video file or a camera's number")
    return video


@dataclass
class LiveReport:
    """What a live run did."""

    poses: list[PoseEstimate] = field(default_factory=list)
    latencies: list[float] = field(default_factory=list)  # s, oldest picture taken -> pose there
    skews: list[float] = field(default_factory=list)  # s, between the pictures of a pose
    skipped: int = 0  # pictures that a newer one replaced

    @property
    def latency_ms(self) -> tuple[float, float]:
        """Median and 95th percentile of the latency, milliseconds; nan before the first pose."""
        if not self.latencies:
            return float("nan"), float("nan")
        low, high = np.percentile(self.latencies, [50, 95])
        return 1e3 * float(low), 1e3 * float(high)

    def track(self, tracker: KnowsPerson, source: str) -> Track:
        """The poses as a track. Raises MachineError when there are none."""
        if not self.poses:
            raise MachineError("no pictures came, so that there is nothing to write")
        times = np.array([pose.time for pose in self.poses])
        count = len(times)
        spent = float(np.mean(self.latencies))
        return Track(
            times=times - times[0], angles=np.stack([p.angles for p in self.poses]),
            joints_head=np.stack([p.joints_head for p in self.poses]), energy=np.zeros(count),
            converged=np.array([p.converged for p in self.poses]),
            detections_used=np.zeros(count), seconds_per_frame=spent,
            config={"detections": source, "live": {"latency_ms": self.latency_ms,
                                                   "skipped": self.skipped}},
            offsets=np.array(tracker.proportions.offsets),
            confidence=np.stack([p.confidence for p in self.poses]),
        )  # fmt: skip


Images = Sequence[UInt8[Array, "H W 3"] | None]
"""RGB pictures, one a view; None where one is missing."""


def follow_live(
    sources: Sequence[Source], detector: DetectsOne, tracker: OnlineTracker,
    seconds: float = float("inf"),
    on_pose: Callable[[PoseEstimate, Images], None] = lambda pose, images: None,
) -> LiveReport:  # fmt: skip
    """Track by detections from sources until all have ended, or for so many seconds.

    A view whose picture does not come in time is missing for that frame.
    """
    return follow_pictures(
        sources,
        lambda images, time: tracker.step(detector.detect_images(images, time)),
        seconds,
        on_pose,
    )


def follow_pictures(
    sources: Sequence[Source], pose_in: Callable[[Images, float], PoseEstimate],
    seconds: float = float("inf"),
    on_pose: Callable[[PoseEstimate, Images], None] = lambda pose, images: None,
) -> LiveReport:  # fmt: skip
    """As `follow_live`, with whatever makes a pose of pictures and their time."""
    report = LiveReport()
    for pictures in _together(sources, seconds):
        taken = [p.taken for p in pictures if p is not None]
        if report.poses and max(taken) <= report.poses[-1].time:
            continue  # a straggler: the other view is already further on
        images = [None if p is None else p.image for p in pictures]
        pose = pose_in(images, max(taken))
        report.poses.append(pose)
        report.latencies.append(time.monotonic() - min(taken))
        report.skews.append(max(taken) - min(taken))
        on_pose(pose, images)
    report.skipped = sum(source.skipped for source in sources)
    return report


def _together(sources: Sequence[Source], seconds: float) -> Iterator[list[Picture | None]]:
    """The newest picture of every source, at least one of them new."""
    end = time.monotonic() + seconds
    while time.monotonic() < end and not all(s.exhausted for s in sources):
        patience = _PATIENCE_S
        pictures: list[Picture | None] = []
        for source in sources:
            pictures.append(source.newest(patience))
            patience = 0.1
        if any(p is not None for p in pictures):
            yield pictures
