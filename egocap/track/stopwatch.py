"""Seconds spent by stage."""

from __future__ import annotations

import time


class Stopwatch:
    """Adds up the seconds of named stages that follow each other."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._since = time.perf_counter()

    def lap(self, stage: str) -> None:
        """Add the time since the last lap to a stage."""
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._since
        self._since = now

    def skip(self) -> None:
        """Leave out the time since the last lap."""
        self._since = time.perf_counter()
