"""Jobs of a recording."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Job:
    """One shard or one episode to make."""

    index: int  # of the shard in its sequence, or of the episode
    frames: range  # frame indices; of an episode its own, from 0
    seed: int
