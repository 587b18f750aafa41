"""Errors that a user's input or machine can cause."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path


class EgocapError(Exception):
    """Root of every error a user's input or machine can cause.

    `exit_code` is what a command returns for it: 2 for bad input, 1 for the environment.
    """

    exit_code = 2

    def __reduce__(self) -> tuple[object, ...]:
        # Subclasses build the message, so `args` are not their constructor's.
        return _rebuild, (type(self), str(self), self.__dict__)


class InputError(EgocapError):
    """A value given by the user is wrong. The message names it and the valid values."""

    def __init__(self, problem: str, *, valid: str | Iterable[str] | None = None) -> None:
        super().__init__(problem + _valid(valid))


class FileError(EgocapError):
    """A file is missing, damaged or has invalid content.

    The message names the file, the key or line, the problem and the valid values.
    """

    def __init__(
        self,
        path: str | Path,
        problem: str,
        *,
        line: int | None = None,
        key: str | None = None,
        valid: str | Iterable[str] | None = None,
    ) -> None:
        where = str(path)
        if line is not None:
            where += f", line {line}"
        if key is not None:
            where += f", key '{key}'"
        super().__init__(f"{where}: {problem}{_valid(valid)}")
        self.path, self.line, self.key = Path(path), line, key


class MachineError(EgocapError):
    """The machine cannot run the command: no OpenGL, a full disk, a missing package."""

    exit_code = 1

    def __init__(self, problem: str, *, remedy: str | None = None) -> None:
        super().__init__(problem + (f"; {remedy}" if remedy else ""))


def _rebuild(kind: type[EgocapError], message: str, state: dict[str, object]) -> EgocapError:
    """Restore an error pickled in another process."""
    error = kind.__new__(kind, message)
    error.__dict__.update(state)
    return error


def _valid(valid: str | Iterable[str] | None) -> str:
    if valid is None:
        return ""
    names = valid if isinstance(valid, str) else ", ".join(valid)
    return f" (valid: {names})"
