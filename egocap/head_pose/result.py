"""Head poses with their uncertainty and gaps, as found, and their npz file.

`egocap.data.head_pose` reads such files: `time` and `T_world_head` are what every reader needs.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from egocap.files import write_npz
from egocap.series import runs


@dataclass(frozen=True, eq=False)
class Gap:
    """A stretch of frames without a head pose."""

    first: int
    last: int
    reason: str


@dataclass(frozen=True, eq=False)
class HeadTrajectory:
    """Head poses of the frames that have one, in a world with z up."""

    frame: Int[Array, "N"]  # of the sequence
    time: Float[Array, "N"]  # s
    T_world_head: Float[Array, "N 4 4"]  # metres
    gaps: tuple[Gap, ...] = ()
    covariance: Float[Array, "N 6 6"] | None = None
    """Of rotation in the head frame [rad], then position in the world [m]; the first pose, the
    direction of up and the height of the floor are taken as exact."""
    facts: dict[str, Any] = field(default_factory=dict)  # how it was found, JSON-ready
    floor_std: float | None = None  # of the floor's height, which is 0, m; None: not known
    points: Float[Array, "P 3"] | None = None  # of the surroundings in the world, m

    def save(self, path: Path) -> None:
        """Write the npz file, atomically. Raises as `egocap.files.disk_errors`."""
        gaps = [{"first": g.first, "last": g.last, "reason": g.reason} for g in self.gaps]
        write_npz(
            path, time=self.time, T_world_head=self.T_world_head, frame=self.frame,
            covariance=self.covariance, gaps=json.dumps(gaps), facts=json.dumps(self.facts),
            floor_std=self.floor_std,
            points=None if self.points is None else self.points.astype(np.float32),
        )  # fmt: skip


def gaps_of(count: int, known: Int[Array, "N"], reasons: dict[int, str]) -> tuple[Gap, ...]:
    """The stretches of `count` frames that are not `known`, with their most frequent reason."""
    missing = np.setdiff1d(np.arange(count), known)
    return tuple(Gap(int(run[0]), int(run[-1]), _usual(run, reasons)) for run in runs(missing))


def _usual(run: Int[Array, "n"], reasons: dict[int, str]) -> str:
    found = [reasons.get(int(i), "no pose") for i in run]
    return max(sorted(set(found)), key=found.count)
