"""An executor of local worker processes; workers that die are replaced.

Workers are spawned, since a fork after a GL context hangs.
"""

from __future__ import annotations

import logging
import multiprocessing as mp
import os
import shutil
import threading
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import wait as wait_for
from pathlib import Path
from typing import Any, TypeVar

from egocap.errors import MachineError
from egocap.workers import WorkerPool
from egocap_sim.record.jobs import E, Enter, Entry, Job, Task

_THREADS = ("LP_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Thread counts of Mesa's software OpenGL and of the numeric libraries."""
_DEATHS = 3  # consecutive deaths of workers without a new frame, before an error
_DEATHS_WITHOUT_JOB = 20  # the same without a finished job
_UNFINISHED = (".shard-*.tmp", ".episode-*.tmp")  # left in the output folder by dead workers

log = logging.getLogger(__name__)

T = TypeVar("T")


class ProcessPool:
    """Runs jobs in a number of spawned processes."""

    separate = True

    def __init__(self, workers: int) -> None:
        self.workers = workers

    def run(self, task: Task[E], jobs: Sequence[Job], out: Path, enter: Enter[E]) -> None:
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
                        "rendering workers keep dying (out of memory, or killed)",
                        remedy="run the same command again to continue, with fewer --workers",
                    ) from None
                log.warning("a rendering worker died and is replaced")

    def _run_pool(
        self, task: Task[E], left: dict[int, Job], out: Path, enter: Enter[E], frames: Any
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


_task: tuple[Task[Any], Path]  # of this worker process
_frames: Any = None  # shared count of frames; None outside workers


def _begin_worker(threads: int, frames: Any, task: Task[Any], out: Path) -> None:
    """Set up a worker process that exits when its parent exits."""
    global _frames, _task
    _frames, _task = frames, (task, out)
    parent = mp.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()
    import cv2

    cv2.setNumThreads(threads)


def _end_with(sentinel: int) -> None:
    wait_for([sentinel])
    os._exit(1)


def _do(job: Job) -> Entry:
    task, out = _task
    return task.do(job, out)


def _remove_unfinished(out: Path) -> None:
    for pattern in _UNFINISHED:
        for path in out.glob(pattern):
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
