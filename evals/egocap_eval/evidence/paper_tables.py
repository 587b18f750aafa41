"""The tables of the page on the paper: its statements beside ours, and its recordings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from egocap_eval.evidence.page_table import Results, Row, markdown, number
from egocap_eval.harness.suite import PaperRow, load_suite
from egocap_eval.harness.thresholds import Numbers

FULL = "full.json"
METHODS = {
    "learned": "from the pictures",
    "learned-like": "simulated, with a weaker detector's errors",
    "noisy": "simulated, 2 px",
    "live": "the same, past only",
    "frame-by-frame": "the same, each frame alone",
    "exact": "exact detections",
}


def paper(results: Results) -> str:
    """The paper's statements with numbers, and ours."""
    header = ("section", "statement", "the paper", "ours", "unit", "conditions of ours")
    if results[FULL].record is None:
        return markdown(header, results.rows(FULL, "the paper's statements", list), results)
    suite = load_suite("full")
    numbers = Numbers(results[FULL].result["scores"], results.folder)
    rows = [
        Row(_file(row), (row.section, row.statement, row.paper, shown["shown"], row.unit,
                         shown["note"]))
        for row, shown in zip(suite.rows, numbers.rows(suite.rows), strict=True)
    ]  # fmt: skip
    return markdown(header, rows, results)


def recordings(results: Results) -> str:
    """Mean errors in the paper's recordings, simulated at their full length and size."""
    rows = results.rows(FULL, "the paper's recordings", _recordings)
    return markdown(("mean error, mm", *METHODS.values()), rows, results)


def _recordings(result: Mapping[str, Any]) -> Iterator[Sequence[str]]:
    scores = result["scores"]
    for sequence in result["suite"]["sequences"]:
        name = sequence["name"]
        yield (name, *(number(scores[method][name]["mpjpe_mm"]) for method in METHODS))


def _file(row: PaperRow) -> str | None:
    """The result that a row's number comes from."""
    if row.ours is None:
        return None
    name, is_file, _ = row.ours.partition(".json:")
    return f"{name}.json" if is_file else FULL
