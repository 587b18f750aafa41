"""A live run: instants in, poses and a report of latency, rate and losses out."""

from __future__ import annotations

import time
from array import array
from collections import defaultdict, deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from queue import Empty, Queue
from threading import Event, Thread
from typing import Any, Protocol, TypeAlias, TypeVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.data.detections import Detections
from egocap.track.online import OnlineTracker, PoseEstimate
from egocap.view.feeds import Feed, Images, Instant

Made = TypeVar("Made")
Stages: TypeAlias = defaultdict[str, "array[float]"]
_Seen: TypeAlias = tuple[Detections, Float[Array, "4 4"] | None]
OnPose: TypeAlias = Callable[[PoseEstimate, Images], None]
"""Takes each pose and the pictures that it is of."""

_WARM_UP_FRAMES = 10
"""More than the tracker solves together."""


class DetectsOne(Protocol):
    """What `egocap.detect.detector.Detector` offers for one instant."""

    def detect_images(self, images: Sequence[Array | None], time: float = 0.0) -> Detections:
        """Detections (T = 1) in one picture a view, None where one is missing."""
        ...


class FindsHead(Protocol):
    """What `egocap.head_pose.online.OnlineHeadPose` offers."""

    def step(
        self, images: Images, time: float, late: Sequence[float]
    ) -> Float[Array, "4 4"] | None:
        """T_world_head at the time of the next pictures, taken `late` seconds after it; or None."""
        ...

    def facts(self) -> dict[str, Any]:
        """What was found so far, JSON-ready."""
        ...


def _numbers() -> array[float]:
    return array("d")


@dataclass
class LiveReport:
    """What a live run did. Eight bytes a number of every pose: runs last for hours."""

    poses: int = 0  # given
    latencies: array[float] = field(default_factory=_numbers)  # s, oldest picture to pose
    skews: array[float] = field(default_factory=_numbers)  # s, between the pictures of a pose
    skipped: int = 0  # pictures that a newer one replaced
    missing: int = 0  # pictures that a pose had to do without
    stages: Stages = field(default_factory=lambda: defaultdict(_numbers))  # s, of every frame
    seconds: float = 0.0  # from the first picture to the last pose
    world: dict[str, Any] = field(default_factory=dict)  # facts of the head poses, where sought

    @property
    def latency_ms(self) -> tuple[float, float] | None:
        """Median and 95th percentile of the latency, milliseconds; None before the first pose."""
        if not self.latencies:
            return None
        low, high = np.percentile(self.latencies, [50, 95])
        return 1e3 * float(low), 1e3 * float(high)

    @property
    def rate(self) -> float:
        """Poses per second."""
        return self.poses / self.seconds if self.seconds else 0.0

    def summary(self) -> dict[str, Any]:
        """Numbers for people and machines, JSON-ready; None for what no pose had."""
        middle, late = self.latency_ms or (None, None)
        skew = 1e3 * float(np.median(self.skews)) if self.skews else None
        return {"poses": self.poses, "poses_per_second": round(self.rate, 2),
                "skipped_pictures": self.skipped, "missing_pictures": self.missing,
                "latency_ms": middle, "latency_95_ms": late, "skew_ms": skew,
                } | {f"{stage}_ms": 1e3 * float(np.median(spent))
                     for stage, spent in self.stages.items()
                } | ({"world": self.world} if self.world else {})  # fmt: skip


class FollowsPictures(Protocol):
    """What makes poses of pictures."""

    def step(self, images: Images, time: float) -> list[PoseEstimate]:
        """Poses of these pictures, or of earlier ones, that are due."""
        ...

    def finish(self) -> list[PoseEstimate]:
        """Poses of pictures that have none yet, at the end."""
        ...


def warm_up(detector: DetectsOne, tracker: OnlineTracker) -> None:
    """Detect and track once in black pictures, so that kernels are compiled or loaded.

    Otherwise a machine's first live run stops for seconds after its first pictures. The tracker
    itself is left as it is.
    """
    black = [np.zeros((c.height, c.width, 3), np.uint8) for c in tracker.rig.cameras]
    found = detector.detect_images(black, 0.0)
    trial = OnlineTracker(tracker.rig, tracker.proportions, tracker.config)
    for time_s in np.arange(1, _WARM_UP_FRAMES + 1) / 30.0:
        trial.step(replace(found, times=np.array([time_s])))


def _not_shown(pose: PoseEstimate, images: Images) -> None:
    pass


def follow_live(
    feed: Feed, detector: DetectsOne, tracker: OnlineTracker, on_pose: OnPose = _not_shown,
    report: LiveReport | None = None, head: FindsHead | None = None,
) -> LiveReport:  # fmt: skip
    """Track by detections until the feed ends. Every pose goes to `on_pose`.

    A thread detects in the next pictures while a pose is tracked and shown; a view whose picture
    did not come in time is missing. Another one finds the `head` in the same pictures. A pose that
    follows its pictures by a lag is shown with them; so it is for the latency. The report given is
    filled as the run goes, also of one that fails.
    """
    report = LiveReport() if report is None else report

    def place(head: FindsHead, instant: Instant) -> Float[Array, "4 4"] | None:
        with lap(report.stages, "head"):
            return head.step(instant.images, instant.time, instant.late)

    def detect(instant: Instant) -> _Seen:
        placed = None if head is None else beside.submit(place, head, instant)
        with lap(report.stages, "detect"):
            found = detector.detect_images(instant.images, instant.time)
        return found, None if placed is None else placed.result()

    def track(_: Instant, seen: _Seen) -> list[PoseEstimate]:
        with lap(report.stages, "track"):
            return tracker.step(*seen)

    try:
        with ThreadPoolExecutor(1, "head") as beside, closing(
            _made_ahead(_timed(feed, report), detect)
        ) as detected:  # fmt: skip
            return _follow(feed, detected, track, tracker.finish, on_pose, report)
    finally:
        report.world = {} if head is None else head.facts()


def follow_pictures(
    feed: Feed, follower: FollowsPictures, on_pose: OnPose = _not_shown,
    report: LiveReport | None = None,
) -> LiveReport:  # fmt: skip
    """As `follow_live`, with whatever makes poses of pictures."""
    report = LiveReport() if report is None else report

    def step(instant: Instant, _: None) -> list[PoseEstimate]:
        return follower.step(instant.images, instant.time)

    instants = ((instant, None) for instant in _timed(feed, report))
    return _follow(feed, instants, step, follower.finish, on_pose, report)


def _follow(
    feed: Feed, instants: Iterator[tuple[Instant, Made]],
    step: Callable[[Instant, Made], list[PoseEstimate]],
    finish: Callable[[], list[PoseEstimate]], on_pose: OnPose, report: LiveReport,
) -> LiveReport:  # fmt: skip
    waiting: deque[Instant] = deque()
    began = None
    for instant, made in instants:
        began = instant.taken if began is None else began
        report.missing += sum(image is None for image in instant.images)
        waiting.append(instant)
        for pose in step(instant, made):
            shown = _at(waiting, pose.time)
            report.latencies.append(time.monotonic() - shown.taken)
            _give(report, pose, shown, on_pose)
        report.seconds = time.monotonic() - began
    for pose in finish():
        _give(report, pose, _at(waiting, pose.time), on_pose)
    report.skipped = feed.skipped
    return report


def _timed(feed: Feed, report: LiveReport) -> Iterator[Instant]:
    """The instants of a feed; the time that each was waited for is a stage."""
    instants = iter(feed)
    while True:
        started = time.perf_counter()
        if (instant := next(instants, None)) is None:
            return
        report.stages["pictures"].append(time.perf_counter() - started)
        yield instant


def _made_ahead(
    instants: Iterator[Instant], make: Callable[[Instant], Made]
) -> Generator[tuple[Instant, Made]]:
    """Each instant with what is made of it, by a thread that works on the next one meanwhile.

    It is given as soon as it is made: `egocap.detect.input_images.ahead` waits for the next job
    first, which here is the next picture of a camera.
    """
    ready: Queue[tuple[Instant, Made] | Exception | None] = Queue(1)
    ended = Event()

    def work() -> None:
        try:
            for instant in instants:
                ready.put((instant, make(instant)))
                if ended.is_set():
                    return
            ready.put(None)
        except Exception as error:  # raised where the poses are wanted
            ready.put(error)

    thread = Thread(target=work, name="detections", daemon=True)
    thread.start()
    try:
        while (found := ready.get()) is not None:
            if isinstance(found, Exception):
                raise found
            yield found
    finally:
        ended.set()
        while thread.is_alive():
            with suppress(Empty):
                ready.get(timeout=0.02)


def _give(report: LiveReport, pose: PoseEstimate, instant: Instant, on_pose: OnPose) -> None:
    report.poses += 1
    report.skews.append(instant.skew)
    with lap(report.stages, "show"):
        on_pose(pose, instant.images)


def _at(waiting: deque[Instant], time: float) -> Instant:
    """The instant of a time; it and earlier ones leave those that wait."""
    while waiting[0].time < time:
        waiting.popleft()
    return waiting.popleft()


@contextmanager
def lap(stages: Stages, stage: str) -> Iterator[None]:
    """Append the time of a block, seconds, to those of a stage."""
    started = time.perf_counter()
    yield
    stages[stage].append(time.perf_counter() - started)
