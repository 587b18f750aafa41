"""A table of a page: rows of numbers, each from one result file, marked where that is stale."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from egocap.errors import InputError
from egocap_eval.evidence.registry import Cited, entries
from egocap_eval.harness.thresholds import COMMITTED

STALE = " †"
NOTE = "† stale: code, weights or data changed since; `egocap-eval refresh` measures it again."
ABSENT = "not measured yet"


@dataclass(frozen=True)
class Row:
    """A row and the result file that its numbers come from; no file for quoted numbers."""

    file: str | None
    cells: Sequence[str]


class Results:
    """The results of a folder by file name."""

    def __init__(self, folder: Path = COMMITTED) -> None:
        self.folder = folder
        self._cited = {name: Cited(entry, folder) for name, entry in entries().items()}

    def __getitem__(self, file: str) -> Cited:
        if file not in self._cited:
            raise InputError(f"no result '{file}'", valid=list(self._cited))
        return self._cited[file]

    def rows(
        self, file: str, label: str, make: Callable[[Any], Iterable[Sequence[str]]]
    ) -> list[Row]:
        """The rows that `make` finds in a result; one that says so where there is no result."""
        if self[file].record is None:
            return [Row(file, (label, ABSENT))]
        return [Row(file, cells) for cells in make(self[file].result)]


def markdown(
    header: Sequence[str], rows: Sequence[Row], results: Results, in_line: bool = False
) -> str:
    """A Markdown table with stale rows marked, and the commands of its numbers below."""
    files = list(dict.fromkeys(row.file for row in rows if row.file is not None))
    stale = {file for file in files if results[file].record is not None and results[file].stale}
    lines = [header, ["---", *["---:"] * (len(header) - 1)]]
    for row in rows:
        mark = STALE if row.file in stale else ""
        lines.append([row.cells[0] + mark, *row.cells[1:],
                      *[""] * (len(header) - len(row.cells))])  # fmt: skip
    text = "\n".join("| " + " | ".join(line) + " |" for line in lines)
    notes = [NOTE] if stale else []
    shown = [f"`{results[file].entry.shown()}`" for file in files]
    if in_line:
        return "\n\n".join([text, " ".join([*notes, "; ".join(shown)])])
    return "\n\n".join([text, *notes, "\n".join(f"- {command}" for command in shown)])


def number(value: float | None, digits: int = 1) -> str:
    """A number; a dash for None."""
    return "-" if value is None else f"{value:.{digits}f}"


def plus_minus(error: float | None, std: float | None, digits: int = 1) -> str:
    """An error and the standard deviation that was stated, where there was one."""
    return number(error, digits) + ("" if std is None else f" ± {std:.{digits}f}")


def interval(entry: Mapping[str, float] | None, digits: int = 1) -> str:
    """A mean with its interval."""
    if entry is None:
        return "-"
    return f"{entry['mean']:.{digits}f} ({entry['low']:.{digits}f} to {entry['high']:.{digits}f})"
