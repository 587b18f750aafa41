"""The regression guard: a small fixed suite compared with a committed baseline."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from egocap.errors import FileError
from egocap.evaluation.table import Table
from egocap_eval.harness.check_suite import SEEDS, SPREAD_SEEDS, Number, measure_suite, suite_config
from egocap_eval.harness.result_file import load_result, save_result
from egocap_eval.harness.study import Outcome

COMMITTED = Path(__file__).parents[1] / "baselines" / "ci.json"


@dataclass(frozen=True)
class Comparison:
    """A number of the suite beside the baseline's."""

    name: str
    baseline: Number | None
    now: float | None

    @property
    def verdict(self) -> str:
        """ "worse", "better", "same", "new" (not in the baseline) or "gone"."""
        if self.baseline is None:
            return "new"
        if self.now is None:
            return "gone"
        change = self.now - self.baseline.value
        if abs(change) <= self.baseline.tolerance:
            return "same"
        if self.baseline.better == "equal":
            return "worse"
        return "better" if (change < 0) == (self.baseline.better == "lower") else "worse"


def study(
    baseline: Annotated[Path | None, arg(metavar="FILE")] = None,
    record: bool = False,
    rendered: bool = True,
) -> Outcome:
    """Run the fixed small suite; exit code 3 when a number is worse than the baseline.

    Args:
        baseline: Numbers to compare with; by default the committed ones.
        record: Measure the numbers and their spread over seeds, and write them as the baseline.
        rendered: Skip the rendered clip (which needs OpenGL) and the detector's scores on it.
    """
    command = "egocap-eval check --record"
    if baseline is None:
        baseline = COMMITTED
    else:
        command += f" --baseline {baseline}"
    if record:
        numbers = measure_suite(seeds=SPREAD_SEEDS, rendered=rendered)
        content = {"numbers": {name: vars(n) for name, n in numbers.items()}}
        save_result(baseline, content, command, config=suite_config())
        return Outcome({"recorded": len(numbers)}, [numbers_table(numbers)])
    known = load_baseline(baseline)
    if not rendered:
        drawn = ("rendered/", "detector/")
        known = {name: n for name, n in known.items() if not name.startswith(drawn)}
    now = measure_suite(seeds=SEEDS, rendered=rendered)
    compared = compare_numbers(known, {name: n.value for name, n in now.items()})
    bad = [c for c in compared if c.verdict in ("worse", "gone")]
    return Outcome(
        {"numbers": {c.name: {"now": c.now, "verdict": c.verdict} for c in compared}},
        comparison_tables(compared),
        [f"{c.name}: {c.verdict}" for c in bad],
        suite_config(),
    )


def load_baseline(path: Path) -> dict[str, Number]:
    """The numbers of a baseline. Raises FileError when it is none."""
    result = load_result(path)["result"]
    try:
        return {name: Number(**number) for name, number in result["numbers"].items()}
    except (KeyError, TypeError, AttributeError):
        raise FileError(path, "not a baseline", valid="a file written with --record") from None


def compare_numbers(baseline: Mapping[str, Number], now: Mapping[str, float]) -> list[Comparison]:
    """Every number of either, in the order of the run."""
    return [Comparison(name, baseline.get(name), now.get(name)) for name in {**now, **baseline}]


def comparison_tables(compared: Sequence[Comparison]) -> list[Table]:
    """What got worse, what got better, and how many stayed."""
    tables = []
    for title, verdicts in (("Worse than the baseline", ("worse", "gone")),
                            ("Better than the baseline (record it again)", ("better",)),
                            ("Not in the baseline (record it again)", ("new",))):  # fmt: skip
        rows = tuple(_row(c) for c in compared if c.verdict in verdicts)
        if rows:
            header = ("number", "baseline", "now", "tolerance", "unit")
            tables.append(Table(title, header, rows))
    same = sum(c.verdict == "same" for c in compared)
    return [*tables, Table("", ("numbers", "within tolerance"), ((str(len(compared)), str(same)),))]


def numbers_table(numbers: Mapping[str, Number]) -> Table:
    """All numbers with their tolerances."""
    rows = tuple((name, f"{n.value:.4g}", f"{n.tolerance:.2g}", n.unit)
                 for name, n in numbers.items())  # fmt: skip
    return Table("The suite", ("number", "value", "tolerance", "unit"), rows)


def _row(compared: Comparison) -> tuple[str, ...]:
    known = compared.baseline
    now = "-" if compared.now is None else f"{compared.now:.4g}"
    if known is None:
        return compared.name, "-", now, "-", ""
    return compared.name, f"{known.value:.4g}", now, f"{known.tolerance:.2g}", known.unit
