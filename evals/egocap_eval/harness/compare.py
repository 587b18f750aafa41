"""Compare two runs of a suite, or two result files, and test changes against noise.

Frame errors of the same method and sequence are paired, so that the difficulty of a frame cancels.
The bootstrap draws blocks of a second, because errors of neighbouring frames are correlated. A
change is significant when the 95 % interval of the mean difference excludes 0; of many rows, one in
twenty does so by chance.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from tyro.conf import Positional, arg

from egocap.errors import FileError, InputError
from egocap.evaluation import MEASURES
from egocap.evaluation.metrics import paired_interval
from egocap.evaluation.scoring import MIN_BLOCKS, bootstrap_block
from egocap.evaluation.table import Table, number
from egocap.files import LARGEST, read_npz
from egocap_eval.harness.result_file import load_result
from egocap_eval.harness.study import Outcome

NOISE_LEVEL = 0.95


def study(
    first: Positional[Annotated[Path, arg(metavar="A")]],
    second: Positional[Annotated[Path, arg(metavar="B")]],
    /,
    all_measures: bool = False,
    seed: int = 0,
) -> Outcome:
    """List what changed from run A to run B (folders of `egocap-eval run`, or two .json results).

    Args:
        first: The earlier run or result.
        second: The later run or result.
        all_measures: Also list measures whose change is less than 1 %.
        seed: Seed of the bootstrap.
    """
    a, b = _loaded(first), _loaded(second)
    config = {name: load["config_sha256"] for name, load in (("a", a), ("b", b))
              if "config_sha256" in load}  # fmt: skip
    if first.is_dir() != second.is_dir():
        raise InputError(f"{first} and {second} are of two kinds", valid="two runs or two results")
    if not first.is_dir():
        rows = changed_numbers(a["result"], b["result"])
        kept = [row for row in rows if all_measures or row["share"] is None or row["share"] >= 0.01]
        return Outcome({"numbers": rows}, [_numbers_table(kept, len(rows))], config=config)
    old, new = (read_npz(folder / "errors.npz") for folder in (first, second))
    errors = paired_changes(old, new, seed=seed)
    scores = changed_scores(a["result"]["scores"], b["result"]["scores"])
    kept = [row for row in scores if all_measures or row["share"] is None or row["share"] >= 0.01]
    tables = [_errors_table(errors), _scores_table(kept, len(scores))]
    suites = [load["result"]["suite"] for load in (a, b)]
    if suites[0] != suites[1]:
        keys = [k for k in suites[0] if suites[0][k] != suites[1].get(k)]
        tables.append(Table("The suites differ in", ("key",), tuple((k,) for k in keys)))
    result = {"errors": errors, "scores": scores, "commits": [a["commit"], b["commit"]]}
    return Outcome(result, tables, config=config)


def paired_changes(
    first: Mapping[str, Float[Array, "T"]], second: Mapping[str, Float[Array, "T"]], *, seed: int
) -> list[dict[str, Any]]:
    """Mean error of every "method/sequence" of both runs, its change, and the interval of it.

    Arrays "times/METHOD/SEQUENCE" hold the frames' times; frames that lack a prediction in either
    run are left out of both.
    """
    rows = []
    for name in first:
        if name.startswith("times/"):
            continue
        if name not in second:
            rows.append({"name": name, "note": "only in A"})
            continue
        times, other = first[f"times/{name}"], second[f"times/{name}"]
        if times.shape != other.shape or not np.allclose(times, other, atol=1e-3):
            rows.append({"name": name, "note": "other frames: cannot be paired"})
            continue
        rows.append({"name": name, **_paired(first[name], second[name], times, seed)})
    only = [n for n in second if n not in first and not n.startswith("times/")]
    return rows + [{"name": name, "note": "only in B"} for name in only]


def changed_scores(a: Mapping[str, Any], b: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Every measure of every method and sequence in both runs, with the spread over seeds."""
    rows = []
    for method, sequence in ((m, s) for m in a for s in a[m] if s in b.get(m, {})):
        for measure, info in MEASURES.items():
            x, y = a[method][sequence].get(measure), b[method][sequence].get(measure)
            if x is None and y is None:
                continue
            spread = [r[method][sequence].get(f"spread/{measure}") for r in (a, b)]
            worse = None
            if x is not None and y is not None and x != y:
                worse = (y > x) == (info.better == "lower")
            rows.append({
                "name": f"{method}/{sequence}", "measure": measure, "a": x, "b": y,
                "share": _share(x, y), "worse": worse,
                "beyond_seeds": _beyond(x, y, spread),
            })  # fmt: skip
    return rows


def changed_numbers(a: Any, b: Any, path: str = "") -> list[dict[str, Any]]:
    """Numbers at the same place of two results that are not the same, and those in one only."""
    inner: list[tuple[str, Any, Any]] = []
    a, b = (dict(enumerate(value)) if isinstance(value, list) else value for value in (a, b))
    if isinstance(a, Mapping) or isinstance(b, Mapping):
        a, b = (value if isinstance(value, Mapping) else {} for value in (a, b))
        inner = [(str(key), a.get(key), b.get(key)) for key in dict.fromkeys([*a, *b])]
    elif a != b and (_is_number(a) or _is_number(b)):
        x, y = _as_number(a), _as_number(b)
        return [{"name": path, "a": x, "b": y, "share": _share(x, y)}]
    prefix = f"{path}." if path else ""
    return [row for key, x, y in inner for row in changed_numbers(x, y, prefix + key)]


def _paired(a: Array, b: Array, times: Array, seed: int) -> dict[str, Any]:
    both = np.isfinite(a) & np.isfinite(b)
    a, b, block = a[both], b[both], bootstrap_block(times)
    row: dict[str, Any] = {"a_mm": _mean(a), "b_mm": _mean(b), "change_mm": _mean(b - a)}
    if len(a) < MIN_BLOCKS * block:
        return row | {"note": f"shorter than {MIN_BLOCKS} s: no interval"}
    low, high = paired_interval(a, b, np.random.default_rng(seed), block=block, level=NOISE_LEVEL)
    verdict = "worse" if low > 0 else "better" if high < 0 else "within noise"
    return row | {"interval_mm": [low, high], "verdict": verdict}


def _mean(values: Array) -> float | None:
    return float(values.mean()) if len(values) else None


def _share(x: float | None, y: float | None) -> float | None:
    if x is None or y is None:
        return None
    return abs(y - x) / max(abs(x), abs(y), 1e-12)


def _beyond(x: float | None, y: float | None, spread: list[float | None]) -> bool | None:
    """Whether the change exceeds what two seeds differ by at 95 %; None where unknown."""
    if x is None or y is None or spread[0] is None or spread[1] is None:
        return None
    return abs(y - x) > 1.96 * float(np.hypot(spread[0], spread[1]))


def _is_number(value: Any) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and abs(value) <= LARGEST


def _as_number(value: Any) -> float | None:
    return float(value) if _is_number(value) else None


def _loaded(path: Path) -> dict[str, Any]:
    record = load_result(path / "scores.json" if path.is_dir() else path)
    if path.is_dir() and "scores" not in record["result"]:
        raise FileError(path, "not a run", valid="a folder made by egocap-eval run")
    return record


def _errors_table(rows: list[dict[str, Any]]) -> Table:
    shown = []
    for row in rows:
        low_high = row.get("interval_mm")
        interval = "" if low_high is None else f"{low_high[0]:+.2f} to {low_high[1]:+.2f}"
        change = row.get("change_mm")
        shown.append((row["name"], number(row.get("a_mm"), 2), number(row.get("b_mm"), 2),
                      "-" if change is None else f"{change:+.2f}", interval,
                      row.get("verdict", row.get("note", ""))))  # fmt: skip
    title = "Mean joint error, mm, paired by frame (95 % interval of the change, blocks of 1 s)"
    return Table(title, ("method/sequence", "A", "B", "change", "interval", "verdict"),
                 tuple(shown))  # fmt: skip


def _scores_table(rows: list[dict[str, Any]], total: int) -> Table:
    beyond = {True: "yes", False: "no", None: "one seed"}
    shown = tuple(
        (row["name"], row["measure"], _number(row["a"]), _number(row["b"]),
         {True: "worse", False: "better", None: ""}[row["worse"]], beyond[row["beyond_seeds"]])
        for row in rows
    )  # fmt: skip
    title = f"Measures that changed by 1 % or more ({len(rows)} of {total})"
    header = ("method/sequence", "measure", "A", "B", "", "beyond seeds")
    return Table(title, header, shown or (("-",) * len(header),))


def _numbers_table(rows: list[dict[str, Any]], total: int) -> Table:
    shown = tuple((row["name"], _number(row["a"]), _number(row["b"])) for row in rows)
    title = f"Numbers that changed by 1 % or more ({len(rows)} of {total} changed at all)"
    return Table(title, ("number", "A", "B"), shown or (("-", "-", "-"),))


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.5g}"
