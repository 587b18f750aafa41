"""Stages of a run and their files: a stage whose input did not change is not run again.

A stage is known by a checksum of its settings and of the stages whose results it takes, kept in
stages.json.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
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
        self._known: dict[str, str] = {}

    def run(
        self, name: str, settings: dict[str, Any], write: Callable[[Path], object],
        read: Callable[[Path], Result], after: tuple[str, ...] = (),
    ) -> Result:  # fmt: skip
        """Content of the stage's file `name`, made by `write` unless it is there already.

        `after`: stages of this run whose results it takes.
        """
        path = self.folder / name
        plain = json.loads(json.dumps(settings, default=str))
        before = [self._known[stage] for stage in after]
        now = self._known[name] = digest({"after": before, "stage": name, "settings": plain})
        if self._done.get(name) != now or not path.exists():
            if self._done.pop(name, None):  # if writing fails, the file is of no known settings
                write_json(self.folder / _NAME, self._done)
            write(path)
            self._done = self._done | {name: now}
            write_json(self.folder / _NAME, self._done)
        return read(path)
