"""What is done for each recording: a function of sources, the path of the result, and settings.

Out: a report, or the error in one line, so that one recording does not end the others.
"""

from __future__ import annotations

import hashlib
import io
import logging
from collections.abc import Callable
from contextlib import nullcontext, redirect_stderr
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import egocap
from egocap.errors import EgocapError, one_line
from egocap.execution.recordings import Recording
from egocap.storage.copies import here

_SOURCES = ("*.py", "*.npz", "*.json", "SHA256SUMS")

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Report:
    """What a command says of one recording."""

    summary: dict[str, Any]  # JSON-ready
    lines: tuple[str, ...]
    missed: bool = False  # exit code 3 with --strict


@dataclass(frozen=True)
class Made:
    """A recording that was worked on: its report, or the error."""

    name: str
    report: Report | None
    error: str = ""


@dataclass(frozen=True)
class RecordingTask:
    """Calls `function(sources, path of the result, **settings)`, a function of a module."""

    function: Callable[..., Report]
    settings: dict[str, Any]
    quiet: bool  # no progress of its own

    def do(self, job: Recording, folder: Path) -> Made:
        """The recording's report. Addresses are fetched here, on the machine that reads them."""
        try:
            with redirect_stderr(io.StringIO()) if self.quiet else nullcontext():
                sources, settings = _fetched(job.sources), _fetched(self.settings)
                report = self.function(sources, folder / job.name, **settings)
        except EgocapError as error:
            return Made(job.name, None, str(error))
        except Exception as error:  # a bug
            log.exception("%s", job.name)
            return Made(job.name, None, one_line(f"{type(error).__name__}: {error}"))
        return Made(job.name, report)

    def portable(self) -> RecordingTask:
        """The same task; what it names, every machine has or fetches."""
        return self

    def version(self) -> str:
        """The version with the first digits of a checksum of the method's sources."""
        return _version()

    def close(self) -> None:
        """Do nothing: a function releases its own resources."""


def _fetched(value: Any) -> Any:
    """The value with local copies in place of addresses."""
    if isinstance(value, tuple):
        return tuple(map(_fetched, value))
    if isinstance(value, dict):
        return {name: _fetched(one) for name, one in value.items()}
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{f.name: _fetched(getattr(value, f.name)) for f in fields(value)})
    if isinstance(value, str):
        return here(value)
    return here(value) if isinstance(value, Path) else value


@cache
def _version() -> str:
    folder, digest = Path(egocap.__file__).parent, hashlib.sha256()
    for path in sorted(p for pattern in _SOURCES for p in folder.rglob(pattern)):
        digest.update(f"{path.relative_to(folder)}\0".encode() + path.read_bytes())
    return f"{egocap.__version__}+{digest.hexdigest()[:10]}"
