"""Numbers of a run by name: thresholds, tables, and the paper's statements beside ours."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from egocap.errors import EgocapError
from egocap.evaluation import MEASURES, PROTOCOLS
from egocap.evaluation.table import Table, number
from egocap_eval.harness.result_file import load_result
from egocap_eval.harness.suite import PaperRow, Suite

COMMITTED = Path(__file__).parents[2] / "results"
NOT_YET = "not measured yet"
NOT_HERE = "not measured yet; an installed package lacks the committed results"


class Numbers:
    """Numbers by name: a run's own scores, its studies' results and the committed ones.

    Args:
        scores: by method, sequence and measure.
        studies: folder of the run's own studies, searched before the committed ones.
        command: the command line of the run.
    """

    def __init__(self, scores: Mapping[str, Any], studies: Path, command: str = "") -> None:
        self.scores, self.command = scores, command
        self._folders = (studies, COMMITTED)

    def of(self, method: str, sequence: str, measure: str) -> float | None:
        """One number of the suite; None if missing."""
        return self.scores.get(method, {}).get(sequence, {}).get(measure)

    def find(self, place: str) -> tuple[float | str | None, str]:
        """What is at "method/sequence/measure" or "STUDY.json:key.key", and the command behind it.

        None and the reason where it is missing.
        """
        if ".json:" not in place:
            method, _, rest = place.partition("/")
            sequence, _, measure = rest.partition("/")
            value = self.of(method, sequence, measure)
            return value, self.command if value is not None else f"{place}: not in this run"
        name, _, keys = place.partition(":")
        for folder in self._folders:
            if (folder / name).is_file():
                return _read_number(folder / name, keys)
        return None, NOT_YET if COMMITTED.is_dir() else NOT_HERE

    def rows(self, rows: Sequence[PaperRow]) -> list[dict[str, Any]]:
        """The paper's statements with our numbers, JSON-ready."""
        return [self._row(row) for row in rows]

    def _row(self, row: PaperRow) -> dict[str, Any]:
        value, note = (None, "") if row.ours is None else self.find(row.ours)
        if isinstance(value, float) and row.less is not None:
            less, why = self.find(row.less)
            value, note = (value - less, note) if isinstance(less, float) else (None, why)
        if isinstance(value, float):
            value *= row.scale
        error = self.find(row.error)[0] if row.error and value is not None else None
        return {
            "section": row.section, "statement": row.statement, "paper": row.paper,
            "unit": row.unit, "ours": value, "error": error,
            "shown": _with_error(value, error, row.digits),
            "command": row.command if value is None else note or row.command,
            "note": "; ".join(x for x in (row.conditions, note if value is None else "") if x),
        }  # fmt: skip


def missed_thresholds(suite: Suite, numbers: Numbers) -> list[str]:
    """Thresholds that are not met, in words; a missing number meets none."""
    missed = []
    for threshold in suite.thresholds:
        there = numbers.scores.get(threshold.method, {})
        names = [threshold.sequence] if threshold.sequence else list(there)
        for sequence in names:
            if sequence not in there:
                continue  # left out of the run, which lists it
            value = numbers.of(threshold.method, sequence, threshold.measure)
            what = f"{threshold.method}, {sequence}: {threshold.measure}"
            if value is None:
                missed.append(f"{what} was not measured")
            elif threshold.most is not None and not value <= threshold.most:
                missed.append(f"{what} is {value:.4g}, not at most {threshold.most:g}")
            elif threshold.least is not None and not value >= threshold.least:
                missed.append(f"{what} is {value:.4g}, not at least {threshold.least:g}")
    return missed


def summary_tables(suite: Suite, numbers: Numbers, *, spread: bool = False) -> list[Table]:
    """One table of measures, one of protocols; a row a method and sequence.

    `spread`: with the spread over seeds, and the 95 % interval of the mean error, in the cells.
    """
    measures, protocols = [], []
    for method, sequences in numbers.scores.items():
        for sequence, entry in sequences.items():
            measures.append((method, sequence, *(_cell(m, entry, spread) for m in suite.measures)))
            errors = (number(entry.get(f"protocol/{p}")) for p in suite.protocols)
            protocols.append((method, sequence, *errors))
    rules = PROTOCOLS[suite.protocols[0]]
    header = ("method", "sequence", *map(_head, suite.measures))
    tables = [Table(f"{rules.name}: {rules.description}", header, tuple(measures))]
    if len(suite.protocols) > 1:
        tables.append(Table("MPJPE, mm, by protocol", ("method", "sequence", *suite.protocols),
                            tuple(protocols)))  # fmt: skip
    return [table for table in tables if table.rows]


def paper_table(suite: Suite, numbers: Numbers, *, commands: bool = False) -> list[Table]:
    """The paper's statements beside our numbers; with commands too wide for a terminal."""
    keys = ("section", "statement", "paper", "shown", "unit", "note", "command")[: 6 + commands]
    rows = tuple(tuple(r[k] for k in keys) for r in numbers.rows(suite.rows))
    header = tuple("ours" if k == "shown" else "conditions" if k == "note" else k for k in keys)
    return [Table("The paper's section 5", header, rows)] if rows else []


def _cell(name: str, entry: Mapping[str, Any], spread: bool) -> str:
    digits = {"mm": 1, "%": 1, "m/s": 3}.get(MEASURES[name].unit, 2)
    cell = number(entry.get(name), digits)
    if spread and (deviation := entry.get(f"spread/{name}")) is not None:
        cell += f" ± {number(deviation, digits)}"
    if spread and name == "mpjpe_mm" and (interval := entry.get("interval")) is not None:
        cell += f" [{number(interval[0])}, {number(interval[1])}]"
    return cell


def _head(name: str) -> str:
    unit = MEASURES[name].unit
    return name.removesuffix("_mm").replace("_", " ") + ("" if unit == "0 to 1" else f", {unit}")


def _with_error(value: float | str | None, error: float | str | None, digits: int) -> str:
    if not isinstance(value, float):
        return "-" if value is None else str(value)
    half = f" +- {number(error, digits)}" if isinstance(error, float) else ""
    return number(value, digits) + half


def _read_number(path: Path, keys: str) -> tuple[float | str | None, str]:
    try:
        record = load_result(path)
    except EgocapError as error:
        return None, str(error)
    value: Any = record["result"]
    for key in keys.split("."):
        if isinstance(value, list) and key.isdigit() and int(key) < len(value):
            value = value[int(key)]
        elif isinstance(value, Mapping) and key in value:
            value = value[key]
        else:
            return None, f"{path.name} has no '{keys}'"
    command = str(record["command"]).split(" --out ")[0]
    if isinstance(value, str):
        return value, command
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None, f"{path.name}: '{keys}' is {json.dumps(value)[:40]}"
    return float(value), command
