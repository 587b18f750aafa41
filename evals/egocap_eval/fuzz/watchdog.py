"""Worker processes that read mutated files, watched from outside of them.

A batch of cases has a process of its own, with a limit on its memory, that reports each case. One
that does not report in time is killed, since nothing inside a process can stop compiled code that
hangs. The case counts as a failure, as does one in which a process dies, and a new process goes on
with the next case.
"""

from __future__ import annotations

import resource
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from pathlib import Path

from egocap_eval.fuzz.targets import Target
from egocap_eval.fuzz.trials import LIMIT_S, Counts, Failure, Trial, copied, keep, trials

LIMIT_BYTES = 1 << 30
GRACE_S = 5.0  # a process stops what hangs in Python by itself
START_S = 300.0  # to import, to write the valid files and to read the target's


@dataclass(frozen=True)
class Batch:
    """Cases of one format. `make` writes its valid file into a folder; it is called in a worker."""

    name: str
    make: Callable[[Path], Target]
    work: Path
    cases: range
    seed: int = 0


def watch(
    batches: list[Batch], workers: int, limit_s: float = LIMIT_S + GRACE_S
) -> Iterator[tuple[Batch, Counts]]:
    """What became of the cases of each batch, in the order in which they end.

    A worker is killed that reports nothing for `limit_s`, or for START_S before its first case.
    """
    waiting, running = batches[::-1], list[_Worker]()
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                running.append(_Worker(waiting.pop()))
            soonest = min(worker.until for worker in running)
            wait([w.reports for w in running], max(0.0, soonest - time.monotonic()))
            for worker in list(running):
                worker.follow(limit_s)
                if worker.done:
                    running.remove(worker)
                    if not worker.counts.failures:
                        shutil.rmtree(worker.batch.work, ignore_errors=True)
                    yield worker.batch, worker.counts
    finally:
        for worker in running:
            worker.kill()


@dataclass
class _Worker:
    """A batch, the process that reads its cases now, and what became of those so far."""

    batch: Batch
    counts: Counts = field(default_factory=Counts)
    done: bool = False

    def __post_init__(self) -> None:
        self._left = self.batch.cases
        self._begin()

    def _begin(self) -> None:
        context = get_context("spawn")
        self.reports, there = context.Pipe(duplex=False)
        self._file: Path | None = None  # of the case in work, from the first report on
        self.until = time.monotonic() + START_S
        batch = replace(self.batch, cases=self._left)
        self._process = context.Process(target=_work, args=(batch, there), daemon=True)
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # inherited: the parent
        self._process.start()  # alone ends at Ctrl-C, and kills its workers
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        there.close()

    def follow(self, limit_s: float) -> None:
        """Take what was reported; replace a process that is late or dead."""
        try:
            while not self.done and self.reports.poll():
                self._take(self.reports.recv())
                self.until = time.monotonic() + limit_s
        except (EOFError, OSError):
            self._process.join(GRACE_S)
            self.kill()
            self._lose(f"its process died, exit code {self._process.exitcode}")
            return
        if not self.done and time.monotonic() > self.until:
            self.kill()
            late = limit_s if self._file else START_S
            self._lose(f"hangs: killed after {late:g} s", late)

    def kill(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.join()

    def _take(self, report: Trial | Path | int) -> None:
        if isinstance(report, Path):
            self._file = report
        elif isinstance(report, Trial):
            self._count(report)
        else:
            self.counts.peak = max(self.counts.peak, report)
            if report > LIMIT_BYTES:
                self._fail(f"{report / 1e9:.1f} GB of memory, in one case of its process")
            self.kill()
            self.done = True

    def _count(self, trial: Trial) -> None:
        self.counts.add(self.batch.name, self.batch.seed, trial)
        self._left = self._left[1:]

    def _lose(self, what: str, hung_s: float = 0.0) -> None:
        """Count the case in work as a failure, and go on with the next one.

        A process that was lost before its first case or after its last one is not replaced.
        """
        if self._file is None or not self._left:
            self._fail(f"{what}, in no case; {len(self._left)} cases are left out")
            self.done = True
            return
        with suppress(OSError):
            keep(self._file, self.batch.work, self._left[0])
        self._count(Trial(self._left[0], failure=what, hung=hung_s > 0.0, seconds=hung_s))
        self._begin()

    def _fail(self, what: str) -> None:
        """Note a failure that is of no certain case."""
        case = self._left[0] if self._left else self.batch.cases[-1]
        self.counts.failures += (Failure(self.batch.name, self.batch.seed, case, what),)


def _work(batch: Batch, reports: Connection) -> None:
    """Report the file that is mutated, each case, and at last the memory needed, bytes."""
    target = batch.make(batch.work / "valid")
    target.load(target.folder or target.file)  # imports and compiles what it needs
    before = _resident()
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + 2 * LIMIT_BYTES, resource.RLIM_INFINITY))
    with suppress(BrokenPipeError):  # the parent was killed
        reports.send(copied(target, batch.work))
        for trial in trials(target, batch.work, batch.cases, batch.seed):
            reports.send(trial)
        reports.send(max(0, _resident() - before))


def _resident() -> int:
    """Largest resident size of this process so far, bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10
