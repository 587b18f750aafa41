"""Worker processes that render shards: here, in a spawned pool that replaces those that die.

Spawned, since a fork after a GL context hangs. Each worker holds one renderer, made with its first
shard, and writes whole shards, so that the bytes are the same for any number of workers.
"""

from __future__ import annotations

import logging
import multiprocessing as mp
import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from egocap.data.sequence import ShardEntry, Truth
from egocap.data.sequence_writer import write_shard
from egocap.errors import MachineError
from egocap_sim.scene.config import Scene
from egocap_sim.sensor.plan import SensorPlan
from egocap_sim.world.stage import person_of, rig_of, sensor_of
from egocap_sim.world.surroundings import extras_of, place_of

if TYPE_CHECKING:
    from egocap_sim.human.body.person import Person
    from egocap_sim.record.frame_writer import FrameMaker

DRAFT = "truth.draft.tmp"
"""Truth before rendering, for the workers; gone when the sequence is whole."""

_THREADS = ("LP_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Thread counts of Mesa's software OpenGL and of the numeric libraries."""
_DEATHS = 3  # of workers one after another, without a frame made between them, before giving up
_DEATHS_OF_JOBS = 20  # the same without a job done: it is the same frame that kills them

log = logging.getLogger(__name__)

Job = TypeVar("Job")
Result = TypeVar("Result")


def make_frames(scene: Scene, folder: Path) -> FrameMaker:
    """The renderer of a scene whose truth before rendering lies in a folder."""
    truth, sensor = Truth.load(folder / DRAFT), sensor_of(scene)
    sensor_plan = SensorPlan.load(folder, sensor, scene.seed) if sensor else None
    return frame_maker(scene, person_of(scene), truth, sensor_plan)


def frame_maker(
    scene: Scene, person: Person, truth: Truth, sensor_plan: SensorPlan | None
) -> FrameMaker:
    """The renderer of a scene."""
    from egocap_sim.record.frame_writer import FrameMaker

    return FrameMaker(
        rig_of(scene.rig, scene.seed),
        person,
        place_of(scene, truth),
        truth,
        scene.record,
        extras_of(scene, truth),
        sensor_plan,
    )


def render_locally(
    scene: Scene,
    out: Path,
    pending: list[tuple[int, range]],
    workers: int,
    enter: Callable[[ShardEntry], None],
) -> None:
    """Render shards in spawned workers and enter each as it is done."""

    def tidy() -> None:
        for half_written in out.glob(".shard-*.tmp"):
            half_written.unlink()

    work_through(dict(pending), _render_shard, (_begin_shards, scene, out), workers, enter, tidy)


def work_through(
    left: dict[int, Job],
    work: Callable[[int, Job], Result],
    begin: tuple[Any, ...],
    workers: int,
    enter: Callable[[Result], None],
    tidy: Callable[[], None],
) -> None:
    """Do numbered jobs in spawned workers and enter the result of each as it is done.

    `begin` is a function and its arguments, called once in every worker. A worker that dies (out of
    memory, or killed) is replaced and its job begun again, after `tidy`. Raises MachineError when
    they keep dying without getting on.
    """
    made = mp.get_context("spawn").RawValue("Q", 0)  # no lock that a killed worker could keep
    deaths = deaths_of_jobs = 0
    while left:
        jobs, frames = len(left), made.value
        try:
            _work_in_pool(left, work, begin, workers, enter, made)
        except BrokenProcessPool:
            tidy()
            deaths_of_jobs = deaths_of_jobs + 1 if len(left) == jobs else 1
            deaths = deaths + 1 if (len(left), made.value) == (jobs, frames) else 1
            if deaths == _DEATHS or deaths_of_jobs == _DEATHS_OF_JOBS:
                raise MachineError(
                    "rendering workers keep dying (out of memory, or killed)",
                    remedy="run the same command again to continue, with fewer --workers",
                ) from None
            log.warning("a rendering worker died; another takes its place")


def _work_in_pool(
    left: dict[int, Job],
    work: Callable[[int, Job], Result],
    begin: tuple[Any, ...],
    workers: int,
    enter: Callable[[Result], None],
    made: Any,
) -> None:
    """Do what is left, taking each job off as it is entered; workers count frames in `made`."""
    workers = max(1, min(workers, len(left)))
    threads = str(max(1, (os.cpu_count() or 1) // workers))
    before = dict(os.environ)
    os.environ |= dict.fromkeys(_THREADS, threads)  # read by libraries as a worker loads them
    pool = ProcessPoolExecutor(
        workers,
        mp_context=mp.get_context("spawn"),
        initializer=_begin_worker,
        initargs=(int(threads), made, begin[0], *begin[1:]),
    )
    try:
        waiting: dict[Future[Result], int] = {
            pool.submit(work, index, job): index for index, job in left.items()
        }
        while waiting:
            done, _ = wait(waiting, return_when=FIRST_COMPLETED)
            for future in done:
                index = waiting.pop(future)
                enter(future.result())
                del left[index]
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        os.environ.clear()
        os.environ.update(before)


_maker: FrameMaker | None = None  # this worker process's own
_task: tuple[Scene, Path]
_made: Any = None  # a count of frames that the parent of worker processes looks at


def files_of(maker: FrameMaker, frames: Iterable[int]) -> Iterator[dict[str, bytes]]:
    """The files of frame after frame; a worker's parent sees that it gets on."""
    for index in frames:
        yield maker.files(index)
        if _made is not None:
            _made.value += 1  # two at once may count as one


def _begin_worker(threads: int, made: Any, begin: Callable[..., None], *arguments: Any) -> None:
    """Set up one worker process; it ends by itself when its parent is gone."""
    global _made
    _made = made
    begin(*arguments)
    parent = mp.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()
    import cv2

    cv2.setNumThreads(threads)


def _begin_shards(scene: Scene, out: Path) -> None:
    global _task
    _task = scene, out


def _end_with(sentinel: int) -> None:
    from multiprocessing.connection import wait as wait_for

    wait_for([sentinel])
    os._exit(1)


def _render_shard(index: int, frames: range) -> ShardEntry:
    global _maker
    scene, out = _task
    if _maker is None:
        _maker = make_frames(scene, out)
    return write_shard(out, index, frames.start, files_of(_maker, frames))
