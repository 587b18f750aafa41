"""One writer for each output: a lock that says who holds it, and commands that take it.

In: the path of a file or folder. While the lock is held, `.NAME.lock` beside a file, or `.lock` in
a folder, names the process. The lock is the kernel's (flock): it ends with its process, however
that ends, so that a stale file is taken over. Who takes it removes the temporary files that a
killed process has left of the output.
"""

from __future__ import annotations

import fcntl
import inspect
import json
import os
import shlex
import socket
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import wraps
from pathlib import Path
from typing import ParamSpec, TypeVar

from egocap.errors import FileError, MachineError
from egocap.files import disk_errors, remove_temporary

IN_FOLDER = ".lock"
_LONGEST_NOTE = 4096  # bytes
P = ParamSpec("P")
R = TypeVar("R")


class OutputLock:
    """The lock of an output file, or with `folder` of an output folder, which is made if missing.

    Missing parents are made too. On release the folders made here are removed if they are empty.
    """

    def __init__(self, target: Path, *, folder: bool = False) -> None:
        self.target = target
        self._inside = target if folder else target.parent
        self._file = self._inside / (IN_FOLDER if folder else f".{target.name}.lock")
        self._folder, self._number = folder, -1
        self._made: list[Path] = []

    def take(self) -> None:
        """Acquire the lock. MachineError names who holds it, or what prevents writing."""
        with disk_errors(self._inside):
            self._made = [p for p in (self._inside, *self._inside.parents) if not p.exists()]
            self._inside.mkdir(parents=True, exist_ok=True)
        if not self._folder and self.target.is_dir():
            raise FileError(self.target, "is a folder", valid="the name of a file")
        try:
            with disk_errors(self._file):
                while self._number < 0:
                    self._number = self._open()
                os.ftruncate(self._number, 0)
                os.write(self._number, _note())
                remove_temporary(self._inside, None if self._folder else self.target.name)
        except BaseException:
            self.release()
            raise

    def release(self) -> None:
        """Release the lock, if it is held."""
        if self._number >= 0:
            self._file.unlink(missing_ok=True)
            os.close(self._number)
            self._number = -1
        for folder in self._made:
            with suppress(OSError):  # not empty
                folder.rmdir()

    def _open(self) -> int:
        """The locked file's number; -1 where its last holder has just removed it."""
        flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
        number = os.open(self._file, flags, 0o644)
        try:
            fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = _holder(os.pread(number, _LONGEST_NOTE, 0))
            os.close(number)
            raise MachineError(
                f"{self.target}: another process is writing it{holder}",
                remedy="wait for it, or choose another output",
            ) from None
        with suppress(FileNotFoundError):
            if os.stat(self._file).st_ino == os.fstat(number).st_ino:  # noqa: PTH116
                return number
        os.close(number)
        return -1


@contextmanager
def holding(target: Path, *, folder: bool = False) -> Iterator[None]:
    """Hold the lock of an output. Raises as `OutputLock.take`."""
    lock = OutputLock(target, folder=folder)
    lock.take()
    try:
        yield
    finally:
        lock.release()


def locks(*names: str, folder: bool = False) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorate a command: it holds the locks of the outputs that these parameters name.

    Parameters that are None are left out.
    """

    def decorated(command: Callable[P, R]) -> Callable[P, R]:
        signature = inspect.signature(command)

        @wraps(command)
        def held(*args: P.args, **kwargs: P.kwargs) -> R:
            bound = signature.bind(*args, **kwargs)
            bound.apply_defaults()
            found = {Path(v) for v in (bound.arguments[n] for n in names) if v is not None}
            with ExitStack() as stack:
                for target in sorted(found):
                    stack.enter_context(holding(target, folder=folder))
                return command(*args, **kwargs)

        return held

    return decorated


def _note() -> bytes:
    command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])[:1000]
    note = {"pid": os.getpid(), "host": socket.gethostname(), "command": command,
            "since": time.strftime("%Y-%m-%d %H:%M:%S %Z")}  # fmt: skip
    return json.dumps(note).encode()


def _holder(note: bytes) -> str:
    """Who holds the lock, in words; empty while its note is not written yet."""
    try:
        who = json.loads(note)
        return (f": process {who['pid']} on {who['host']} since {who['since']}, "
                f"`{str(who['command'])[:100]}`")  # fmt: skip
    except (ValueError, TypeError, KeyError, RecursionError):
        return ""
