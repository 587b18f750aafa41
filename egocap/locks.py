"""One writer for each output: a lock that says who holds it, and commands that take it.

In: the path of a file or folder. While the lock is held, `.NAME.lock` beside a file, or `.lock` in
a folder, names the process. The lock is the kernel's (flock): it ends with its process, however
that ends, so that a stale file is taken over. Who takes it removes the temporary files that a
killed process has left of the output, those in a folder's own folders too.
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
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from egocap.errors import FileError, InputError, MachineError
from egocap.files import disk_errors, remove_temporary

IN_FOLDER = ".lock"
_LONGEST_NOTE = 4096  # bytes
P = ParamSpec("P")
R = TypeVar("R")


class HeldError(MachineError):
    """Another process holds the lock of an output."""


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
        """Acquire the lock. HeldError names who holds it; MachineError what prevents writing."""
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
                for folder in _unlocked(self._inside) if self._folder else ():
                    with suppress(OSError):  # not ours to read or to change
                        remove_temporary(folder)
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
            raise HeldError(
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


def locks(
    *names: str, folder: bool = False, replaces: str | None = None
) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorate a command: it holds the locks of the outputs that these parameters name.

    Parameters that are None are left out. An output that is also one of the command's input files,
    other than that of the parameter `replaces`, is refused, and so are two outputs in one file.
    """

    def decorated(command: Callable[P, R]) -> Callable[P, R]:
        signature = inspect.signature(command)

        @wraps(command)
        def held(*args: P.args, **kwargs: P.kwargs) -> R:
            bound = signature.bind(*args, **kwargs)
            bound.apply_defaults()
            found = {n: Path(v) for n in names if (v := bound.arguments[n]) is not None}
            require_distinct(found, {
                n: v for n, v in bound.arguments.items() if n not in (*names, replaces)
            })  # fmt: skip
            with ExitStack() as stack:
                for target in sorted(found.values()):
                    stack.enter_context(holding(target, folder=folder))
                return command(*args, **kwargs)

        return held

    return decorated


def require_distinct(outputs: Mapping[str, Path], inputs: Mapping[str, Any]) -> None:
    """Raise InputError for an output that is an input file or another output.

    Inputs are parameters by name; those that are no paths, and no tuples of them, are left out.
    """
    read = [
        (name, word) for name, value in inputs.items()
        for word in (value if isinstance(value, tuple) else (value,))
        if isinstance(word, str | Path) and _is_file(word)
    ]  # fmt: skip
    for i, (name, path) in enumerate(outputs.items()):
        if path in list(outputs.values())[:i]:
            raise InputError(f"{path}: two outputs in one file", valid=f"another --{name}")
        for other, word in read:
            if _is_file(path) and path.samefile(word):
                raise InputError(f"{path}: the output would replace the input '{other}'",
                                 valid="another name")  # fmt: skip


def _is_file(word: str | Path) -> bool:
    """Whether a word of a command line names a file; False for what no file can be named."""
    try:
        return Path(word).is_file()
    except (OSError, ValueError):
        return False


def _note() -> bytes:
    command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])[:1000]
    note = {"pid": os.getpid(), "host": socket.gethostname(), "command": command,
            "since": time.strftime("%Y-%m-%d %H:%M:%S %Z")}  # fmt: skip
    return json.dumps(note).encode()


def _unlocked(folder: Path) -> list[Path]:
    """The folders in a folder in which nothing has a lock of its own."""
    inner = [path for path in folder.iterdir() if path.is_dir() and not path.is_symlink()]
    return [path for path in inner if not any(path.glob(".*lock"))]


def _holder(note: bytes) -> str:
    """Who holds the lock, in words; empty while its note is not written yet."""
    try:
        who = json.loads(note)
        return (f": process {who['pid']} on {who['host']} since {who['since']}, "
                f"`{str(who['command'])[:100]}`")  # fmt: skip
    except (ValueError, TypeError, KeyError, RecursionError):
        return ""
