"""Read mutated copies of a file in this process: each is read, refused, or a failure.

A foreign exception or more than 10 s is a failure. A reader that hangs inside compiled code is
stopped by `watchdog` only, from another process.
"""

from __future__ import annotations

import shutil
import signal
import time
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from egocap.errors import EgocapError
from egocap_eval.fuzz.mutations import mutated
from egocap_eval.fuzz.targets import Target

LIMIT_S = 10.0


@dataclass(frozen=True)
class Trial:
    """What became of one mutated file."""

    case: int
    refused: bool = False
    failure: str | None = None
    hung: bool = False
    seconds: float = 0.0


@dataclass(frozen=True)
class Failure:
    """A mutated file that was neither read nor refused, and the seed and case of its mutation."""

    target: str
    seed: int
    case: int
    what: str


@dataclass
class Counts:
    """What became of the mutated files of one format."""

    read: int = 0
    refused: int = 0
    hung: int = 0  # of the failures: those that only the end of their process stopped
    failures: tuple[Failure, ...] = ()
    longest: float = 0.0  # seconds
    peak: int = 0  # bytes above a process's size before

    def add(self, name: str, seed: int, trial: Trial) -> None:
        """Count a mutated file of a format."""
        self.longest = max(self.longest, trial.seconds)
        self.hung += trial.hung
        if trial.failure is not None:
            self.failures += (Failure(name, seed, trial.case, trial.failure),)
        elif trial.refused:
            self.refused += 1
        else:
            self.read += 1


def fuzz(target: Target, work: Path, cases: range, seed: int = 0) -> Counts:
    """Read mutated copies of a target's file; keeps those that fail in `work`."""
    counts = Counts()
    for trial in trials(target, work, cases, seed):
        counts.add(target.name, seed, trial)
    return counts


def copied(target: Target, work: Path) -> Path:
    """Copy a target's file, or its folder, into `work`; the path of the file there."""
    copy = work / "copy"
    shutil.rmtree(copy, ignore_errors=True)
    if target.folder is not None:
        shutil.copytree(target.folder, copy)
    else:
        copy.mkdir(parents=True)
    return copy / target.file.relative_to(target.folder or target.file.parent)


def trials(target: Target, work: Path, cases: Iterable[int], seed: int) -> Iterator[Trial]:
    """Read the cases one after the other, each in the place of a new copy of the file."""
    content, file = target.file.read_bytes(), copied(target, work)
    for case in cases:
        file.write_bytes(mutated(content, file.suffix, np.random.default_rng([seed, case])))
        begun, refused, failure = time.perf_counter(), False, None
        try:
            with _alarm(), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                target.load(work / "copy" if target.folder is not None else file)
        except EgocapError:
            refused = True
        except Exception as error:
            failure = f"{type(error).__name__}: {error!s:.100}"
            keep(file, work, case)
        yield Trial(case, refused, failure, seconds=time.perf_counter() - begun)
    shutil.rmtree(work / "copy")


def keep(file: Path, work: Path, case: int) -> None:
    """Copy the file of a case that failed."""
    shutil.copy(file, work / f"failed-{case}{file.suffix}")


@contextmanager
def _alarm() -> Iterator[None]:
    """Raise TimeoutError in the block after LIMIT_S seconds."""

    def stop(*_: object) -> None:
        raise TimeoutError(f"more than {LIMIT_S:g} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, LIMIT_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
