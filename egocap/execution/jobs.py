"""Jobs, the task that does them, and executors that run tasks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol, TypeVar


class Job(Protocol):
    """One piece of work."""

    @property
    def index(self) -> int:
        """Number of the job in its run."""
        ...


class Entry(Protocol):
    """What a finished job is listed with; `name` is the file or folder that it made."""

    @property
    def name(self) -> str: ...


J = TypeVar("J", bound=Job, contravariant=True)
E = TypeVar("E", bound=Entry, covariant=True)
Enter = Callable[[E], None]
"""Called in the parent with the entry of each finished job."""


class Task(Protocol[J, E]):
    """How to do the jobs of one run; it is pickled and sent to worker processes."""

    def do(self, job: J, folder: Path) -> E:
        """Make the file or folder of a job in `folder`, complete or not at all."""
        ...

    def portable(self) -> Task[J, E]:
        """The same task without references to files of this run on this machine."""
        ...

    def version(self) -> str:
        """Version of the code that this process does jobs with."""
        ...

    def close(self) -> None:
        """Release what the task holds, such as a GL context."""
        ...


class Executor(Protocol):
    """Runs the jobs of a task."""

    separate: bool
    """Whether tasks run in other processes, which cannot share objects with this one."""

    def run(self, task: Task[J, E], jobs: Sequence[J], out: Path, enter: Enter[E]) -> None:
        """Do the jobs and put what they make in the folder `out`, in any order.

        Raises MachineError when workers cannot be started or keep dying.
        """
        ...


class InProcess:
    """Runs jobs one after another in this process and thread."""

    separate = False

    def run(self, task: Task[J, E], jobs: Sequence[J], out: Path, enter: Enter[E]) -> None:
        """Do the jobs in order."""
        try:
            for job in jobs:
                enter(task.do(job, out))
        finally:
            task.close()
