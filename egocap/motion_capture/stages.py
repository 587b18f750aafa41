"""Stages of a run and their files: a stage whose input did not change is not run again.

A stage is known by a checksum of its settings and of all stages planned before it, kept in
stages.json. Stages may be made at the same time, in threads, if none reads another's file.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar

from egocap.data.sequence_writer import digest
from egocap.errors import FileError
from egocap.files import write_json
from egocap.schema import read_json

_NAME = "stages.json"
Result = TypeVar("Result")


class Stages:
    """Runs the stages of one folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._done: dict[str, Any] = {}
        with suppress(FileError):
            self._done = read_json(folder / _NAME)
        self._chain, self._writing = "", Lock()

    def run(
        self, name: str, settings: dict[str, Any], write: Callable[[Path], object],
        read: Callable[[Path], Result],
    ) -> Result:  # fmt: skip
        """Content of the stage's file `name`, made by `write` unless it is there already."""
        return self.plan(name, settings, write, read)()

    def plan(
        self, name: str, settings: dict[str, Any], write: Callable[[Path], object],
        read: Callable[[Path], Result],
    ) -> Callable[[], Result]:  # fmt: skip
        """The next stage, as a function that does what `run` does, in any thread."""
        path = self.folder / name
        plain = json.loads(json.dumps(settings, default=str))
        chain = self._chain = digest({"before": self._chain, "stage": name, "settings": plain})

        def made() -> Result:
            if self._done.get(name) != chain or not path.exists():
                self._note(name, None)  # if writing fails, the file is of no known settings
                write(path)
                self._note(name, chain)
            return read(path)

        return made

    def _note(self, name: str, chain: str | None) -> None:
        """Keep by what input and settings a file was made; None: not known."""
        with self._writing:
            if self._done.get(name) == chain:
                return
            self._done = {n: c for n, c in self._done.items() if n != name}
            if chain is not None:
                self._done[name] = chain
            write_json(self.folder / _NAME, self._done)
