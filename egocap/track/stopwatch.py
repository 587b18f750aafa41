"""Seconds spent by stage, and the frames that the finished stages are worth.

A stage works on all frames at once. Its share of the whole is taken from measured times; the rate
and the time left follow from how fast the stages really pass.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from egocap.pose.config import TrackerConfig

OnFrames = Callable[[int], None]

_WORK = {
    "observe": 0.04, "frames": 0.45, "smoothing": 0.5, "covariance": 0.2, "appearance check": 4.5,
    "world": 2.2, "colour": 15.0, "joints": 0.5,
}  # fmt: skip
"""Milliseconds a frame of a lap, measured on one core; `palette` does not grow with the frames."""
WORLD_SOLUTIONS = 2
"""With contacts: the network sees them more clearly in a motion that stands on them."""
_MOST = 0.98
"""Share before the end: a second solution after the appearance check may take longer."""


class Stopwatch:
    """Adds up the seconds of named stages that follow each other.

    `on_lap` is called with the name of a stage at the end of each of its laps.
    """

    def __init__(self, on_lap: Callable[[str], None] = lambda stage: None) -> None:
        self.seconds: dict[str, float] = {}
        self._on_lap = on_lap
        self._since = time.perf_counter()

    def lap(self, stage: str) -> None:
        """Add the time since the last lap to a stage."""
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._since
        self._since = now
        self._on_lap(stage)

    def skip(self) -> None:
        """Leave out the time since the last lap."""
        self._since = time.perf_counter()


class StageProgress:
    """Calls `on_frames` with the frames that the finished laps of stages stand for."""

    def __init__(
        self, frames: int, config: TrackerConfig, on_frames: OnFrames, *, images: bool, world: bool
    ) -> None:
        self._frames, self._on_frames = frames, on_frames
        laps = planned_laps(config, images=images, world=world)
        self._planned = sum(_WORK[stage] * count for stage, count in laps.items())
        self._spent, self._told = 0.0, 0

    def lap(self, stage: str) -> None:
        """A lap of a stage is finished."""
        self._spent += _WORK.get(stage, 0.0)
        self._tell(int(self._frames * min(self._spent / self._planned, _MOST)))

    def finish(self) -> None:
        """All is finished."""
        self._tell(self._frames)

    def _tell(self, done: int) -> None:
        if done > self._told:
            self._on_frames(done - self._told)
            self._told = done


def planned_laps(config: TrackerConfig, *, images: bool, world: bool) -> dict[str, int]:
    """Laps of every stage, if the appearance check leads to one solution more."""
    checks = images and config.checks_appearance
    solutions = 2 if checks else 1
    aligns = config.synchronise or config.align_cameras
    smoothing = 3 + aligns + 8 * config.multistart if config.smoothing == "interval" else 1
    return {
        "observe": 1, "frames": solutions, "smoothing": solutions * smoothing,
        "covariance": solutions * config.covariance, "appearance check": solutions * checks,
        "world": WORLD_SOLUTIONS * (world and config.solves_world),
        "colour": images and config.colour, "joints": 1,
    }  # fmt: skip
