"""Measure how closely the simulated person follows real motion, clip by clip."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from tyro.conf import arg

from egocap.commandline import progress
from egocap.errors import EgocapError, FileError, InputError
from egocap.evaluation.table import Table, number
from egocap_eval.harness.cases import map_in_processes
from egocap_eval.harness.study import Outcome
from egocap_sim.core.trajectory import PhysicsStats

if TYPE_CHECKING:
    from egocap_sim.human.body.person import Person

KINDS = (".bvh", ".npz")

COLUMNS: dict[str, tuple[str, int]] = {
    "joint_error_cm": ("error cm", 2),
    "joint_error_p95_cm": ("p95", 2),
    "joint_error_max_cm": ("max", 1),
    "planted_foot_speed_cm_s": ("slide cm/s", 1),
    "penetration_cm": ("depth cm", 2),
    "penetration_max_cm": ("max", 2),
    "residual_wrench_bw": ("residual BW", 2),
    "ms_per_second": ("ms/s", 0),
}
"""Column head and decimals of each measure."""

TARGETS: dict[str, tuple[str, str, float]] = {
    "worst clip's joint error": ("joint_error_cm", "max", 2.0),
    "median joint error": ("joint_error_cm", "median", 0.6),
    "median slide of planted feet": ("planted_foot_speed_cm_s", "median", 8.0),
    "median depth under the floor": ("penetration_cm", "median", 1.5),
}
"""Measure, its statistic over the clips, and its maximum."""


@dataclass(frozen=True)
class ClipResult:
    """One clip: its measures, or the reason for having none."""

    name: str
    seconds: float
    stats: PhysicsStats | None
    problem: str = ""


def study(
    motions: Annotated[Path, arg(metavar="DIR")], person: int = 0, workers: int = 1
) -> Outcome:
    """Retarget and simulate every motion clip of a folder; exit code 3 when a target is missed.

    Args:
        motions: Folder of .bvh and .npz clips.
        person: Seed of the person who moves.
        workers: Number of processes.
    """
    clips = run_physics(motions, person=person, workers=workers)
    result = {
        "person_seed": person,
        "clips": len(clips),
        "seconds": round(sum(clip.seconds for clip in clips), 2),
        "median": _rounded(summary(clips, "median")),
        "worst": _rounded(summary(clips, "max")),
        "per_clip": [
            {"name": clip.name, "seconds": round(clip.seconds, 2)}
            | (_rounded(_measures(clip.stats)) if clip.stats else {"problem": clip.problem})
            for clip in clips
        ],
    }
    return Outcome(result, [table(clips)], missed(clips))


def run_physics(motions: Path, *, person: int = 0, workers: int = 1) -> list[ClipResult]:
    """Retarget and simulate every .bvh and .npz clip under a folder.

    Raises FileError for a folder without clips. A clip that fails is a result with its problem.
    """
    jobs = [(path, str(path.relative_to(motions)), person) for path in find_clips(motions)]
    if not 1 <= workers <= 64:
        raise InputError(f"{workers} workers", valid="1 to 64")
    results: list[ClipResult] = []
    with progress("physics", len(jobs), unit="clips") as advance:
        for result in map_in_processes(simulate_clip, jobs, workers):
            results.append(result)
            advance()
    return results


def summary(clips: Sequence[ClipResult], how: str) -> dict[str, float]:
    """'median' or 'max' of every measure over the clips that have measures."""
    take = {"median": np.median, "max": np.max}[how]
    rows = [clip.stats for clip in clips if clip.stats is not None]
    return {
        name: float(take([getattr(stats, name) for stats in rows])) if rows else float("inf")
        for name in COLUMNS
    }


def missed(clips: Sequence[ClipResult]) -> list[str]:
    """Targets that are not met, in words; failed clips are listed too."""
    found = [f"{clip.name}: {clip.problem}" for clip in clips if clip.stats is None]
    for what, (figure, how, most) in TARGETS.items():
        value = summary(clips, how)[figure]
        if not value <= most:
            found.append(f"{what} is {value:.2f}, not {most:g}")
    return found


def table(clips: Sequence[ClipResult]) -> Table:
    """A row for each clip, the median and the worst below."""
    rows = []
    for clip in clips:
        cells = _cells(_measures(clip.stats)) if clip.stats else ["-"] * len(COLUMNS)
        rows.append((clip.name, number(clip.seconds), *cells, clip.problem))
    seconds = number(sum(clip.seconds for clip in clips), 0)
    rows += [(how, seconds, *_cells(summary(clips, how)), "") for how in ("median", "max")]
    header = ("clip", "s", *(head for head, _ in COLUMNS.values()), "problem")
    return Table("", header, tuple(rows))


def find_clips(motions: Path) -> list[Path]:
    """The clips under a folder, sorted by path."""
    if not motions.is_dir():
        raise FileError(motions, "no such folder", valid="a folder of .bvh or .npz clips")
    paths = sorted(p for p in motions.rglob("*") if p.suffix.lower() in KINDS and p.is_file())
    if not paths:
        raise FileError(motions, "holds no motion clips", valid=KINDS)
    return paths


def simulate_clip(job: tuple[Path, str, int]) -> ClipResult:
    """One clip (path, name, the person's seed) from file to measures."""
    from egocap_sim.motion.clips.load import load_clip
    from egocap_sim.motion.retarget.retarget import retarget
    from egocap_sim.physics.simulation import simulate

    path, name, seed = job
    person = _person(seed)
    try:
        reference = retarget(load_clip(path), person)
        trajectory = simulate(person, reference)
    except EgocapError as problem:
        return ClipResult(name, 0.0, None, str(problem))
    return ClipResult(name, reference.duration_s, trajectory.stats)


@cache
def _person(seed: int) -> Person:
    from egocap_sim.human.clothing.wardrobe import make_person

    return make_person(seed)


def _measures(stats: PhysicsStats) -> dict[str, float]:
    return {name: getattr(stats, name) for name in COLUMNS}


def _cells(figures: dict[str, float]) -> list[str]:
    return [number(figures[name], places) for name, (_, places) in COLUMNS.items()]


def _rounded(figures: dict[str, float]) -> dict[str, float | None]:
    """For JSON, which has no infinity: None where nothing could be measured."""
    return {n: round(v, 4) if math.isfinite(v) else None for n, v in figures.items()}
