"""Jobs of a recording, the task that does them, and executors that run tasks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar


@dataclass(frozen=True)
class Job:
    """One shard or one episode to make."""

    index: int  # of the shard in its sequence, or of the episode
    frames: range  # frame indices; of an episode its own, from 0
    seed: int


class Entry(Protocol):
    """The manifest entry of a finished job; `name` is its file or folder."""

    @property
    def name(self) -> str: ...


E = TypeVar("E", bound=Entry, covariant=True)
Enter = Callable[[E], None]
"""Called in the parent with the entry of each finished job."""


class Task(Protocol[E]):
    """How to do the jobs of one recording; it is pickled and sent to worker processes."""

    def do(self, job: Job, folder: Path) -> E:
        """Make the file or folder of a job in `folder`, complete or not at all."""
        ...

    def portable(self) -> Task[E]:
        """The same task without references to files of this run on this machine."""
        ...

    def close(self) -> None:
        """Release what the task holds, such as a GL context."""
        ...


class Executor(Protocol):
    """Runs the jobs of a task."""

    separate: bool
    """Whether tasks run in other processes, which cannot share objects with this one."""

    def run(self, task: Task[E], jobs: Sequence[Job], out: Path, enter: Enter[E]) -> None:
        """Do the jobs and put what they make in the folder `out`, in any order.

        Raises MachineError when workers cannot be started or keep dying.
        """
        ...


class InProcess:
    """Runs jobs one after another in this process and thread."""

    separate = False

    def run(self, task: Task[E], jobs: Sequence[Job], out: Path, enter: Enter[E]) -> None:
        """Do the jobs in order."""
        try:
            for job in jobs:
                enter(task.do(job, out))
        finally:
            task.close()
