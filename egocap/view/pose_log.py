"""Poses of a live run in a temporary file, so that memory does not grow; a track in the end."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO

import numpy as np

from egocap.body.proportions import Proportions
from egocap.body.skeleton import DOF_COUNT
from egocap.data.head_pose import HeadPoses, in_world
from egocap.data.track import Track
from egocap.files import disk_errors
from egocap.track.online import PoseEstimate
from egocap.view.live_run import LiveReport

_POSE = np.dtype([
    ("time", "f8"), ("angles", "f8", DOF_COUNT), ("joints_head", "f8", (18, 3)),
    ("covariance", "f8", (18, 3, 3)), ("confidence", "f8", 18), ("converged", "?"),
    ("T_world_head", "f8", (4, 4)),
])  # fmt: skip
"""The fields of a `PoseEstimate`; a head pose that is not known is not a number."""
_UNKNOWN = np.full((4, 4), np.nan)


class PoseLog:
    """Keeps every pose. Made by `pose_log`."""

    def __init__(self, file: IO[bytes], path: Path) -> None:
        self._file, self.path = file, path

    def append(self, pose: PoseEstimate) -> None:
        """Keep a pose. Raises MachineError when the disk is full."""
        values = vars(pose)
        if pose.T_world_head is None:
            values = values | {"T_world_head": _UNKNOWN}
        record = np.array(tuple(values[name] for name in _POSE.names or ()), _POSE).tobytes()
        with disk_errors(self.path):
            while record:
                record = record[self._file.write(record) :]

    def take(self, proportions: Proportions, source: str, report: LiveReport) -> Track:
        """The poses, of which there is one, as a track; the log is empty then.

        It is in the world, too, where a head pose is known. `source` names what the poses were made
        of, `report` is that of the run. A pose that a full disk cut is left out, and the log's room
        on the disk is free for the track.
        """
        with disk_errors(self.path):
            self._file.seek(0)
            written = self._file.read()
            self._file.truncate(0)
        poses = np.frombuffer(written, _POSE, len(written) // _POSE.itemsize)
        count = len(poses)
        heads = HeadPoses.of([None if np.isnan(T[0, 0]) else T for T in poses["T_world_head"]])
        track = Track(
            times=poses["time"] - poses["time"][0], angles=poses["angles"].copy(),
            joints_head=poses["joints_head"].copy(), energy=np.zeros(count),
            converged=poses["converged"].copy(), detections_used=np.zeros(count),
            seconds_per_frame=report.seconds / count,
            config={"detections": source, "live": report.summary()},
            offsets=np.array(proportions.offsets), covariance=poses["covariance"].copy(),
            confidence=poses["confidence"].copy(),
        )  # fmt: skip
        return track if heads is None else in_world(track, heads)


@contextmanager
def pose_log(path: Path) -> Iterator[PoseLog]:
    """The log for a track's file: without a name beside it, gone with the block or the process."""
    with ExitStack() as stack:
        with disk_errors(path):
            file = stack.enter_context(TemporaryFile(buffering=0, dir=path.parent))
        yield PoseLog(file, path)
