"""The committed results: how each is made, what it costs, and whether it is stale."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

from pydantic import Field

from egocap.errors import FileError, InputError
from egocap.schema import Strict, checked, read_toml
from egocap_eval.harness.result_file import load_result, shipped_weights
from egocap_eval.harness.sources import source_hashes
from egocap_eval.harness.study_sources import sources_of
from egocap_eval.harness.thresholds import COMMITTED

FILE = Path(__file__).with_name("results.toml")
ROOT = COMMITTED.parents[1]


class ResultEntry(Strict):
    """How one result is made. The commands hold {work} and {motions}."""

    file: str = Field(pattern=r"^[\w.-]+\.json$")
    command: str
    prepare: tuple[str, ...] = ()
    minutes: float = 0.0  # of the preparation, and of what the result does not record
    only_if_named: bool = False

    def shown(self) -> str:
        """The command as it is cited."""
        return self.command.replace("{work}", "WORK").replace("{motions}", "DIR")

    def commands(self, work: Path, motions: Path) -> list[list[str]]:
        """The words of all commands, in their order; the last one writes the result."""
        places = {"work": str(work), "motions": str(motions)}
        lines = [shlex.split(line.format(**places)) for line in (*self.prepare, self.command)]
        return [*lines[:-1], [*lines[-1], "--out", f"evals/results/{self.file}"]]


class _Registry(Strict):
    results: tuple[ResultEntry, ...]


@cache
def entries() -> Mapping[str, ResultEntry]:
    """All results by file name."""
    return read_registry(FILE)


def read_registry(path: Path) -> Mapping[str, ResultEntry]:
    """The results that a file lists, by file name. Raises FileError."""
    return {e.file: e for e in checked(_Registry, read_toml(path), path).results}


def chosen(names: Sequence[str]) -> list[ResultEntry]:
    """The results of these names, with or without .json; without names, all that may be run
    unasked. Raises InputError."""
    known = entries()
    files = [n if n.endswith(".json") else f"{n}.json" for n in names]
    unknown = [file for file in files if file not in known]
    if unknown:
        raise InputError(f"no result {', '.join(unknown)}", valid=list(known))
    return [known[file] for file in files] or [e for e in known.values() if not e.only_if_named]


@dataclass(frozen=True)
class Cited:
    """A result as it lies in a folder; without the file, there is no record."""

    entry: ResultEntry
    folder: Path = COMMITTED

    @cached_property
    def record(self) -> Mapping[str, Any] | None:
        """The file's content. Raises FileError for one that is no result."""
        path = self.folder / self.entry.file
        return load_result(path) if path.is_file() else None

    @property
    def result(self) -> Any:
        """The study's own numbers. Raises FileError if they are missing."""
        if self.record is None:
            raise FileError(self.folder / self.entry.file, "no such file")
        return self.record["result"]

    @cached_property
    def stale(self) -> tuple[str, ...]:
        """The reasons why the result must be measured again, in words; none for a fresh one."""
        record = self.record
        if record is None:
            return ("not measured yet",)
        clean = record.get("commit") and not record["commit"].endswith("+changes")
        found = [] if clean else ["not made from a commit"]
        before = record.get("sources")
        if before is None:
            return (*found, "made before sources were recorded")
        now = source_hashes(sources_of(self.entry.command))
        changed = [path for path in {**now, **before} if now.get(path) != before.get(path)]
        found += [f"changed since: {', '.join(changed)}"] if changed else []
        if record.get("weights", shipped_weights()) != shipped_weights():
            found.append("of other detector weights")
        return tuple(found)

    @property
    def minutes(self) -> float:
        """Estimated wall time to make it again."""
        seconds = (self.record or {}).get("seconds", {}).get("wall", 0.0)
        return self.entry.minutes + seconds / 60.0
