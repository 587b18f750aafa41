"""Errors that a user's input or machine can cause."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.util import find_spec
from pathlib import Path

LONGEST_MESSAGE, LONGEST_KEY, LONGEST_VALID = 300, 60, 1000
"""Characters of a message without its valid values, of a key, and of a list of valid values.

All of them may quote a file of any content.
"""


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
        super().__init__(one_line(problem) + _valid(valid))


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
            where += f", key '{one_line(key, LONGEST_KEY)}'"
        super().__init__(one_line(f"{where}: {problem}") + _valid(valid))
        self.path, self.line, self.key = Path(path), line, key


class MachineError(EgocapError):
    """The machine cannot run the command: no OpenGL, a full disk, a missing package."""

    exit_code = 1

    def __init__(self, problem: str, *, remedy: str | None = None) -> None:
        super().__init__(one_line(problem) + (f"; {remedy}" if remedy else ""))


def require(package: str, extra: str) -> None:
    """Raise MachineError, with the extra to install, unless a package can be imported."""
    if find_spec(package) is None:
        raise MachineError(
            f"the package '{package}' is missing", remedy=f"pip install 'egocap[{extra}]'"
        )


def _rebuild(kind: type[EgocapError], message: str, state: dict[str, object]) -> EgocapError:
    """Restore an error pickled in another process."""
    error = kind.__new__(kind, message)
    error.__dict__.update(state)
    return error


def _valid(valid: str | Iterable[str] | None) -> str:
    if valid is None:
        return ""
    names = valid if isinstance(valid, str) else ", ".join(valid)
    return f" (valid: {one_line(names, LONGEST_VALID)})"


def one_line(text: str, most: int = LONGEST_MESSAGE) -> str:
    """The text in one line: control characters escaped, the middle of a long text left out."""
    if not text.isprintable():
        text = "".join(c if c.isprintable() else repr(c)[1:-1] for c in " ".join(text.split("\n")))
    return text if len(text) <= most else f"{text[: most - 40]} ... {text[-35:]}"
