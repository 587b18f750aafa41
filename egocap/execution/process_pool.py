"""An executor of local worker processes; workers that die are replaced.

Workers are spawned, since a fork after a GL context hangs.
"""

from __future__ import annotations

import logging
import multiprocessing as mp
import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from egocap.errors import MachineError
from egocap.execution.jobs import E, Enter, Entry, J, Job, Task
from egocap.workers import WorkerPool

_THREADS = ("LP_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Thread counts of Mesa's software OpenGL and of the numeric libraries."""
_DEATHS = 3  # consecutive deaths of workers without a new frame, before an error
_DEATHS_WITHOUT_JOB = 20  # the same without a finished job
_UNFINISHED = ".*.tmp"  # left in the output folder by dead workers

log = logging.getLogger(__name__)

T = TypeVar("T")


class ProcessPool:
    """Runs jobs in a number of spawned processes."""

    separate = True

    def __init__(self, workers: int) -> None:
        self.workers = workers

    def run(self, task: Task[J, E], jobs: Sequence[J], out: Path, enter: Enter[E]) -> None:
        """Do the jobs; restart those of a worker that dies (out of memory, or killed).

        Raises MachineError when workers keep dying without progress.
        """
        left = {job.index: job for job in jobs}
        frames = mp.get_context("spawn").RawValue("Q", 0)  # no lock: a killed worker could keep it
        deaths = deaths_without_job = 0
        while left:
            before = len(left), frames.value
            try:
                self._run_pool(task, left, out, enter, frames)
            except BrokenProcessPool:
                _remove_unfinished(out)
                deaths_without_job = deaths_without_job + 1 if len(left) == before[0] else 1
                deaths = deaths + 1 if (len(left), frames.value) == before else 1
                if deaths == _DEATHS or deaths_without_job == _DEATHS_WITHOUT_JOB:
                    raise MachineError(
                        "workers keep dying (out of memory, or killed)",
                        remedy="run the same command again to continue, with fewer --workers",
                    ) from None
                log.warning("a worker died and is replaced")

    def _run_pool(
        self, task: Task[J, E], left: dict[int, J], out: Path, enter: Enter[E], frames: Any
    ) -> None:
        """Do the jobs in `left` until a worker dies; remove each finished one."""
        workers = max(1, min(self.workers, len(left)))
        threads = max(1, (os.cpu_count() or 1) // workers)
        with (
            _environment(dict.fromkeys(_THREADS, str(threads))),  # read as a worker starts
            WorkerPool(workers, _begin_worker, threads, frames, task, out) as pool,
        ):
            waiting: dict[Future[Any], int] = {
                pool.submit(_do, job): index for index, job in left.items()
            }
            while waiting:
                done, _ = wait(waiting, return_when=FIRST_COMPLETED)
                for future in done:
                    index = waiting.pop(future)
                    enter(future.result())
                    del left[index]


def count_frames(frames: Iterable[T]) -> Iterator[T]:
    """Yield the frames; in a worker, increment the count that it shares with its parent."""
    for frame in frames:
        yield frame
        if _frames is not None:
            _frames.value += 1  # not atomic: may miss one


_task: tuple[Task[Any, Any], Path]  # of this worker process
_frames: Any = None  # shared count of frames; None outside workers


def _begin_worker(threads: int, frames: Any, task: Task[Any, Any], out: Path) -> None:
    global _frames, _task
    _frames, _task = frames, (task, out)
    import cv2

    cv2.setNumThreads(threads)


def _do(job: Job) -> Entry:
    task, out = _task
    return task.do(job, out)


def _remove_unfinished(out: Path) -> None:
    for path in out.glob(_UNFINISHED):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink()


@contextmanager
def _environment(variables: dict[str, str]) -> Iterator[None]:
    before = dict(os.environ)
    os.environ |= variables
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)
