"""An executor that runs jobs on the workers of a Dask cluster and receives their files as bytes.

A shared folder is not required. Every machine needs the same version of EgoCap, the files that the
task names and, for the same bytes of pictures, the same GL driver. Dask restarts the jobs of a
worker that dies. Requires the extra `egocap[cluster]`.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from uuid import uuid4

from egocap.data.dataset_writer import replace_episode
from egocap.errors import MachineError, require
from egocap.execution.jobs import E, Enter, Entry, J, Job, Task
from egocap.files import write_atomically

_TIMEOUT_S = 10  # for the connection to the scheduler
_ATTEMPTS = 8  # to run jobs whose task the cluster lost, with the last worker that had it

Files = bytes | dict[str, bytes] | None
"""Content of the file, or of each file in the folder, that a job made; None: it made nothing."""


class DaskCluster:
    """Runs jobs on the workers of the Dask scheduler at an address."""

    separate = True

    def __init__(self, address: str) -> None:
        self.address = address

    def run(self, task: Task[J, E], jobs: Sequence[J], out: Path, enter: Enter[E]) -> None:
        """Do the jobs. Raises MachineError without Dask or scheduler, or if workers keep dying."""
        portable, name = task.portable(), uuid4().hex[:16]
        left = {job.index: job for job in jobs}

        def place(result: tuple[int, E, Files]) -> None:
            index, entry, files = result
            _write(files, out / entry.name)
            enter(entry)
            del left[index]

        with connect(self.address) as client:
            for attempt in range(_ATTEMPTS):
                if not left:
                    return
                sent = client.scatter(portable, broadcast=True, hash=False)
                futures = [
                    client.submit(
                        do_remotely, name, task.version(), sent, job,
                        key=f"egocap-{name}-{index}-{attempt}", pure=False,
                    )
                    for index, job in left.items()
                ]  # fmt: skip
                _gather(client, futures, place)
        if left:
            raise MachineError(f"the cluster lost the input of {len(left)} jobs {_ATTEMPTS} times")


def connect(address: str) -> Any:
    """A client of a Dask scheduler. Raises MachineError without Dask or scheduler."""
    require("distributed", "cluster")
    from distributed import Client

    try:
        return Client(address, timeout=_TIMEOUT_S)
    except (OSError, ValueError) as error:
        reason = str(error) or type(error).__name__
        raise MachineError(f"no Dask scheduler at '{address}': {reason}") from None


def _gather(client: Any, futures: list[Any], place: Callable[[Any], None]) -> None:
    """Place results as they arrive. Dask cancels futures whose input the cluster lost."""
    from distributed import KilledWorker, as_completed

    try:
        for future, result in as_completed(futures, with_results=True, raise_errors=True):
            if not future.cancelled():
                place(result)
            future.release()
    except KilledWorker as error:
        raise MachineError(f"the workers of a job keep dying: {error}") from None
    finally:
        client.cancel(futures)


def _write(files: Files, path: Path) -> None:
    """Put the file or folder that a job made in place."""
    if files is None:
        return
    if isinstance(files, bytes):
        write_atomically(path, files)
        return
    made = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    shutil.rmtree(made, ignore_errors=True)
    made.mkdir()
    for name, content in files.items():
        (made / name).parent.mkdir(parents=True, exist_ok=True)
        write_atomically(made / name, content)
    replace_episode(made, path)


_thread = ThreadPoolExecutor(1)  # a GL context belongs to one thread; Dask has several
_held: tuple[str, Task[Any, Any]] | None = None  # name and task of this worker


def do_remotely(
    name: str, version: str, task: Task[Any, Any], job: Job
) -> tuple[int, Entry, Files]:
    """Do a job in a Dask worker. Raises MachineError if the worker runs another version."""
    if version != task.version():
        raise MachineError(f"a worker runs version {task.version()}, not {version}")
    return _thread.submit(_do, name, task, job).result()


def _do(name: str, task: Task[Any, Any], job: Job) -> tuple[int, Entry, Files]:
    global _held
    if _held is None or _held[0] != name:
        if _held is not None:
            _held[1].close()
        _held = name, task.portable()
    with tempfile.TemporaryDirectory(prefix="egocap-") as folder:
        entry = _held[1].do(job, Path(folder))
        made = Path(folder) / entry.name
        return job.index, entry, _read(made)


def _read(made: Path) -> Files:
    if made.is_dir():
        files = (path for path in sorted(made.rglob("*")) if path.is_file())
        return {path.relative_to(made).as_posix(): path.read_bytes() for path in files}
    return made.read_bytes() if made.exists() else None
