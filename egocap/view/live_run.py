"""A live run: instants in, poses and a report of latency, rate and losses out."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy import ndarray as Array

from egocap.body.proportions import Proportions
from egocap.data.detections import Detections
from egocap.data.track import Track
from egocap.errors import MachineError
from egocap.track.online import OnlineTracker, PoseEstimate
from egocap.view.feeds import Feed, Images


class KnowsPerson(Protocol):
    """What `OnlineTracker` and `ColourTracker` have in common here."""

    proportions: Proportions


class DetectsOne(Protocol):
    """What `egocap.detect.detector.Detector` offers for one instant."""

    def detect_images(self, images: Sequence[Array | None], time: float = 0.0) -> Detections:
        """Detections (T = 1) in one picture a view, None where one is missing."""
        ...


@dataclass
class LiveReport:
    """What a live run did."""

    poses: list[PoseEstimate] = field(default_factory=list)
    latencies: list[float] = field(default_factory=list)  # s, oldest picture taken -> pose there
    skews: list[float] = field(default_factory=list)  # s, between the pictures of a pose
    skipped: int = 0  # pictures that a newer one replaced
    missing: int = 0  # pictures that a pose had to do without
    seconds: float = 0.0  # from the first picture to the last pose

    @property
    def latency_ms(self) -> tuple[float, float]:
        """Median and 95th percentile of the latency, milliseconds; nan before the first pose."""
        if not self.latencies:
            return float("nan"), float("nan")
        low, high = np.percentile(self.latencies, [50, 95])
        return 1e3 * float(low), 1e3 * float(high)

    @property
    def rate(self) -> float:
        """Poses per second."""
        return len(self.poses) / self.seconds if self.seconds else 0.0

    def summary(self) -> dict[str, float]:
        """Numbers for people and machines."""
        middle, late = self.latency_ms
        skew = float(np.median(self.skews)) if self.skews else float("nan")
        return {"poses": len(self.poses), "poses_per_second": round(self.rate, 2),
                "skipped_pictures": self.skipped, "missing_pictures": self.missing,
                "latency_ms": middle, "latency_95_ms": late, "skew_ms": 1e3 * skew}  # fmt: skip

    def track(self, tracker: KnowsPerson, source: str) -> Track:
        """The poses as a track. Raises MachineError when there are none."""
        if not self.poses:
            raise MachineError("no pictures came, so that there is nothing to write")
        times = np.array([pose.time for pose in self.poses])
        count = len(times)
        return Track(
            times=times - times[0], angles=np.stack([p.angles for p in self.poses]),
            joints_head=np.stack([p.joints_head for p in self.poses]), energy=np.zeros(count),
            converged=np.array([p.converged for p in self.poses]),
            detections_used=np.zeros(count), seconds_per_frame=float(np.mean(self.latencies)),
            config={"detections": source, "live": self.summary()},
            offsets=np.array(tracker.proportions.offsets),
            confidence=np.stack([p.confidence for p in self.poses]),
        )  # fmt: skip


def follow_live(
    feed: Feed, detector: DetectsOne, tracker: OnlineTracker,
    on_pose: Callable[[PoseEstimate, Images], None] = lambda pose, images: None,
) -> LiveReport:  # fmt: skip
    """Track by detections until the feed ends.

    A view whose picture does not come in time is missing for that frame.
    """
    return follow_pictures(
        feed, lambda images, time: tracker.step(detector.detect_images(images, time)), on_pose
    )


def follow_pictures(
    feed: Feed, pose_in: Callable[[Images, float], PoseEstimate],
    on_pose: Callable[[PoseEstimate, Images], None] = lambda pose, images: None,
) -> LiveReport:  # fmt: skip
    """As `follow_live`, with whatever makes a pose of pictures and their time."""
    report, began = LiveReport(), None
    for instant in feed:
        began = instant.taken if began is None else began
        pose = pose_in(instant.images, instant.time)
        report.poses.append(pose)
        report.latencies.append(time.monotonic() - instant.taken)
        report.skews.append(instant.skew)
        report.missing += sum(image is None for image in instant.images)
        report.seconds = time.monotonic() - began
        on_pose(pose, instant.images)
    report.skipped = feed.skipped
    return report
