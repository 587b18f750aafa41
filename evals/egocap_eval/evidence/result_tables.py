"""The tables of README and docs by name; those of all results together."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from egocap_eval.evidence.footage_tables import adapted, captures, head_path
from egocap_eval.evidence.image_tables import (
    SETS,
    TRACKED,
    clips,
    detection,
    in_world,
    poses,
    procedural,
    rigs,
    set_label,
)
from egocap_eval.evidence.page_table import ABSENT, Results, Row, interval, markdown, number
from egocap_eval.evidence.paper_tables import paper, recordings
from egocap_eval.evidence.registry import entries
from egocap_eval.evidence.study_tables import (
    ablation,
    baseline,
    cost,
    coverage,
    doubt,
    image_model,
    physics,
    refined,
    simulated,
    simulation,
    speed,
    start_up,
)
from egocap_eval.studies.personalised import LIVE

Page = Callable[[Results], str]


def summary(results: Results) -> str:
    """README: detection and tracking from images, each set one row."""
    header = (
        "motions",
        "joints within 20 px, in view",
        "offline, body known",
        "the same, head's path found",
        "offline, body fitted",
        "the same, head's path found",
        "live, body known",
        "live, 0.1 s lag",
    )
    rows: list[Row] = []
    for file, name in SETS.items():
        rows += results.rows(
            file,
            f"{name} set, recorded",
            lambda r: [
                (
                    set_label(r),
                    interval(r["mean"]["detector"]["pck20_in_view"]),
                    *(
                        interval(r["mean"][case]["mpjpe_mm"]) if case in r["mean"] else "-"
                        for case in TRACKED
                    ),
                )
            ],
        )
    rows += results.rows("personalised-validation.json", "validation, procedural", _procedural)
    rows += results.rows("recordings.json", "validation, procedural", _recordings)
    return markdown(header, rows, results, in_line=True)


def mutation(results: Results) -> str:
    """Mutants of the formula modules that tests kill."""

    def rows_of(result: Mapping[str, Any]) -> Iterator[Sequence[str]]:
        for name, module in {**result["modules"], "all": result["total"]}.items():
            yield (
                f"`{name}`" if name != "all" else name,
                *(str(module[count]) for count in ("mutants", "killed", "equivalent")),
                *(f"{100.0 * module[score]:.1f}" for score in ("score", "adjusted")),
            )

    header = ("module", "mutants", "killed", "explained as equivalent", "killed, % of all",
              "% without the explained")  # fmt: skip
    return markdown(header, results.rows("mutation.json", "mutants", rows_of), results)


def missed(results: Results) -> str:
    """Targets that results miss, in their own words."""
    rows = [
        Row(file, (file.removesuffix(".json"), what))
        for file in entries()
        if results[file].record is not None
        for what in results[file].result.get("missed", ())
    ]
    lines = "\n".join(f"- {row.cells[0]}: {row.cells[1]}" for row in rows)
    return lines or "None."


def reproduce(results: Results) -> str:
    """The command of every result, its cost and its commit."""
    lines = ["| Result | Command | Minutes | Commit |", "|---|---|---:|---|"]
    for file, entry in entries().items():
        more = f" (after {len(entry.prepare)} other commands)" if entry.prepare else ""
        lines.append(
            f"| `{file}` | `{entry.shown()}`{more} | {results[file].minutes:.0f} "
            f"| {_commit(results[file].record)} |"
        )
    return "\n".join(lines)


TABLES: Mapping[str, Page] = {
    table.__name__: table
    for table in (
        summary,
        detection,
        rigs,
        speed,
        poses,
        in_world,
        head_path,
        refined,
        clips,
        procedural,
        simulated,
        baseline,
        coverage,
        doubt,
        ablation,
        captures,
        adapted,
        simulation,
        cost,
        start_up,
        physics,
        image_model,
        mutation,
        paper,
        recordings,
        missed,
        reproduce,
    )
}


def _procedural(result: Mapping[str, Any]) -> Iterator[Sequence[str]]:
    by_scene: dict[str, dict[str, float]] = {}
    for row in result["rows"]:
        by_scene.setdefault(row["sequence"], {})[row["body"]] = row["mpjpe_mm"]
    for scene, errors in by_scene.items():
        yield (
            f"validation, procedural: {scene}",
            "-",
            number(errors["true"]),
            "-",
            number(errors["fitted"]),
            "-",
            number(errors.get(LIVE)),
            "-",
        )


def _recordings(result: Mapping[str, Any]) -> Iterator[Sequence[str]]:
    errors = [scores["mpjpe_mm"] for scores in result["scores"]["learned"].values()]
    label = f"validation, procedural: {len(errors)} other recordings"
    yield label, "-", f"{min(errors):.1f} to {max(errors):.1f}", *"-" * 5


def _commit(record: Mapping[str, Any] | None) -> str:
    if record is None:
        return ABSENT
    commit, plus, changes = (record.get("commit") or "none").partition("+")
    return commit[:8] + plus + changes
