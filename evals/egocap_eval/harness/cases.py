"""The loop behind every study that compares: cases, subjects and seeds in; scores out.

A case is what changes (a level of a fault, settings of the tracker, a body, a training set), a
subject what it is tried on (a motion, a sequence), a seed one draw of the noise. All cases have the
same subjects and seeds, so that changes can be taken in pairs.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from egocap.commandline import progress
from egocap.errors import FileError
from egocap.evaluation.table import Table
from egocap.files import disk_errors
from egocap.workers import WorkerPool
from egocap_eval.harness.intervals import format_interval, mean_and_interval
from egocap_eval.harness.result_file import config_hash, git_commit

Case = TypeVar("Case")
Subject = TypeVar("Subject")
Result = TypeVar("Result")
Scores = Mapping[str, Any]
Runs = Mapping[str, Sequence[Sequence[Scores]]]
"""Scores by case, then subject, then seed."""


class ScoreLog:
    """Finished scores by name, in a file if one is given, so that a stopped study continues.

    One JSON object a line; truncated lines are skipped. `config` is what the scores
    depend on: with it, only scores of the same configuration and commit are reused. `check`
    raises TypeError for scores of another study. Raises FileError for a file of something else.
    """

    def __init__(
        self, path: Path | None = None, *, check: Callable[[dict[str, Any]], object] = dict,
        **config: Any,
    ) -> None:  # fmt: skip
        self._path = path
        self._scores: dict[str, dict[str, Any]] = {}
        self._prefix = ""
        if path is None:
            return
        if config:
            self._prefix = config_hash({"commit": git_commit(), **config})[:16] + "/"
        with disk_errors(path.parent):
            path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists():
            self._read(path, check)

    def __contains__(self, key: str) -> bool:
        return self._prefix + key in self._scores

    def __getitem__(self, key: str) -> dict[str, Any]:
        return self._scores[self._prefix + key]

    def add(self, key: str, score: Scores) -> None:
        """Keep a score, in the file as well."""
        self._scores[self._prefix + key] = dict(score)
        if self._path is not None:
            row = {"frame": self._prefix + key, "score": dict(score)}
            with disk_errors(self._path.parent), self._path.open("a") as file:
                file.write("\n" + json.dumps(row))

    def _read(self, path: Path, check: Callable[[dict[str, Any]], object]) -> None:
        try:
            lines = [line for line in path.read_text().split("\n") if line]
        except (OSError, UnicodeDecodeError) as error:
            raise FileError(path, f"cannot be read: {error}") from None
        for line in lines:
            try:
                row = json.loads(line)
                check(row["score"])
                self._scores[row["frame"]] = dict(row["score"])
            except (ValueError, KeyError, TypeError):
                continue
        if len(lines) > 1 and not self._scores:
            raise FileError(path, "holds no scores", valid="a file this study made")


def run_cases(
    title: str,
    cases: Mapping[str, Case],
    subjects: Mapping[str, Subject],
    score: Callable[[Case, Subject, int], Scores],
    *,
    seeds: int = 1,
    log: ScoreLog | None = None,
) -> dict[str, list[list[Scores]]]:
    """Score every case on every subject with every seed; scores in the log are reused.

    Returns the scores by case, then subject, then seed.
    """
    log = log or ScoreLog()
    found: dict[str, list[list[Scores]]] = {}
    with progress(title, len(cases) * len(subjects) * seeds, unit="runs") as advance:
        for name, case in cases.items():
            found[name] = []
            for who, subject in subjects.items():
                runs: list[Scores] = []
                for seed in range(seeds):
                    key = f"{title}/{name}/{who}/{seed}"
                    if key not in log:
                        log.add(key, score(case, subject, seed))
                    runs.append(log[key])
                    advance()
                found[name].append(runs)
    return found


def map_in_processes(
    function: Callable[[Any], Result], jobs: Sequence[Any], workers: int
) -> Iterator[Result]:
    """Results of a function in the order of the jobs; above one worker, in spawned processes."""
    if workers < 2:
        yield from map(function, jobs)
        return
    with WorkerPool(workers) as pool:
        yield from pool.map(function, jobs)


def subject_means(
    runs: Sequence[Sequence[Scores]], measures: Sequence[str]
) -> dict[str, list[float | None]]:
    """Each measure of every subject: a mean over the seeds that have one, else None."""
    return {name: [mean([scores[name] for scores in of_seeds]) for of_seeds in runs]
            for name in measures}  # fmt: skip


def mean(values: Sequence[float | None]) -> float | None:
    """Mean of the values that are not None; None if there are none."""
    known = [v for v in values if v is not None]
    return float(np.mean(known)) if known else None


def paired_change(
    before: Sequence[float | None], after: Sequence[float | None]
) -> dict[str, float] | None:
    """Mean change over the subjects, and its interval; None below two subjects."""
    pairs = zip(before, after, strict=True)
    return mean_and_interval([None if a is None or b is None else b - a for a, b in pairs])


@dataclass(frozen=True)
class Sweep:
    """A fault, its unit, and what each of its levels changes."""

    unit: str
    words: str
    levels: Mapping[float, Any]


def run_sweep(
    name: str, sweep: Sweep, subjects: Mapping[str, Subject],
    score: Callable[[Any, Subject, int], Scores], measures: Sequence[str], *, seeds: int = 1,
    log: ScoreLog | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Every measure at every level, JSON-ready: mean over subjects, interval, and each subject's.

    Two subjects or more have an interval.
    """
    cases = {f"{value:g}": level for value, level in sweep.levels.items()}
    runs = run_cases(name, cases, subjects, score, seeds=seeds, log=log)
    levels = []
    for value in sweep.levels:
        draws = subject_means(runs[f"{value:g}"], measures)
        means = {measure: mean_and_interval(draws[measure]) for measure in measures}
        levels.append({"value": value, **means, "draws": draws})
    return {"unit": sweep.unit, "words": sweep.words, "levels": levels}


def sweep_table(name: str, sweep: Mapping[str, Any], measures: Sequence[str]) -> Table:
    """The result of a sweep, a row for each level."""
    rows = tuple((f"{level['value']:g}", *(format_interval(level[m]) for m in measures))
                 for level in sweep["levels"])  # fmt: skip
    header = (f"{name}, {sweep['unit']}", *(m.replace("_mm", ", mm") for m in measures))
    return Table(f"{sweep['words']} (mean +- 95 % interval)", header, rows)
