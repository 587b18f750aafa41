"""Run a suite in two passes: make sequences and predictions, then score the saved predictions.

    OUT/suite.json                     the suite as run, with its hash
    OUT/sequences/NAME/                what was generated
    OUT/predictions/METHOD/NAME.S.npz  poses, S the seed of the detections' noise
    OUT/studies/NAME.json              studies' results
    OUT/scores.json, errors.npz        all numbers; each frame's error, for comparisons
    OUT/report.html, .md               the report

Existing files are not made again. A prediction records the hash of everything it depends on; one
made with other settings, or from another sequence, is refused.
"""

from __future__ import annotations

import logging
import shlex
import sys
from collections.abc import Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import Positional, arg

from egocap.data.sequence import Sequence
from egocap.errors import FileError, InputError
from egocap.evaluation.measures import MEASURES
from egocap.evaluation.pose_errors import PoseErrors
from egocap.evaluation.predictions import load_predictions
from egocap.evaluation.protocol import find_protocol
from egocap.evaluation.scoring import make_report, prediction_errors
from egocap.files import write_npz
from egocap.locks import holding
from egocap.schema import read_json
from egocap_eval.harness.commands import STUDIES, main
from egocap_eval.harness.footage import prepare_sequences
from egocap_eval.harness.predict import (
    Job,
    discard_changed,
    find_sources,
    load_description,
    plan,
    predict,
    require_same,
    settings,
)
from egocap_eval.harness.result_file import load_result, save_result, write_text
from egocap_eval.harness.sources import source_hashes
from egocap_eval.harness.study import Outcome
from egocap_eval.harness.study_sources import sources_of
from egocap_eval.harness.suite import Suite, find_suite, load_suite, shortened
from egocap_eval.harness.thresholds import Numbers, missed_thresholds, paper_table, summary_tables

log = logging.getLogger(__name__)


def study(
    suite: Positional[Annotated[str, arg(metavar="SUITE")]],
    /,
    work: Annotated[Path | None, arg(metavar="DIR")] = None,
    motions: Annotated[Path | None, arg(metavar="DIR")] = None,
    workers: int = 2,
    html: bool = True,
    frames: Annotated[int | None, arg(metavar="N")] = None,
    again: bool = False,
    allow_code: bool = False,
    cluster: Annotated[str | None, arg(metavar="ADDRESS")] = None,
) -> Outcome:
    """Run a suite; exit code 3 when a threshold is missed.

    Missing sequences and predictions are made; the saved predictions are scored.

    Args:
        suite: Name of a built-in suite (quick), or a .toml file.
        work: Folder for sequences, predictions and the report; out/SUITE by default, and
            out/SUITE-N with --frames N.
        motions: Folder of motion clips, for the sequences that need one.
        workers: Rendering processes.
        html: Do not write report.html and report.md.
        frames: Try the suite: at most N frames of each sequence, one seed, no studies.
        again: Make predictions and studies of other settings, weights or code again; without it,
            those of other settings or weights are refused.
        allow_code: Run functions that the suite names as MODULE:FUNCTION.
        cluster: Address of a Dask scheduler whose workers render missing sequences.
    """
    path = find_suite(suite)
    loaded = load_suite(path)
    _require_known(loaded)
    if not allow_code:
        _refuse_code(loaded, path)
    if frames is not None:
        loaded = shortened(loaded, frames)
    work = Path("out") / loaded.name if work is None else work
    asked = ["egocap-eval", "run", suite, *(["--frames", str(frames)] if frames else [])]
    with holding(work, folder=True):
        make = _Making(work, motions, workers, cluster, again, html, shlex.join(asked))
        return _run(loaded, path, make)


@dataclass(frozen=True)
class _Making:
    """Where and how the parts of a suite are made; the options of `study`."""

    work: Path
    motions: Path | None
    workers: int
    cluster: str | None
    again: bool
    html: bool
    command: str


def _run(loaded: Suite, path: Path, make: _Making) -> Outcome:
    """Run a suite of a file in its work folder."""
    work, again = make.work, make.again
    _require_same_suite(work, loaded)
    sequences = prepare_sequences(
        loaded, path.parent, work, make.motions, make.workers, make.cluster
    )
    sources, absent = find_sources(loaded, path.parent, sequences)
    jobs = list(plan(loaded, sequences, path.parent, work, sources))
    for job in jobs:  # all of them before any long work
        discard_changed(job) if again else require_same(job)
    run_studies(loaded, work, again)
    predict(jobs, sequences)
    scores, scored = score(loaded, jobs, sequences)
    numbers = Numbers(scores, work / "studies", make.command)
    missed = missed_thresholds(loaded, numbers) + missed_by_studies(loaded, work)
    config, result = _summary(loaded, jobs, sequences, absent, numbers)
    save_result(work / "scores.json", {**result, "missed": missed}, numbers.command, config=config)
    _save_errors(work / "errors.npz", scored)
    if make.html:
        from egocap_eval.harness.report_page import Run, write_report

        write_report(work, Run(loaded, result, missed, scored, sequences, numbers))
        log.info("report: %s", work / "report.html")
    tables = [*summary_tables(loaded, numbers), *paper_table(loaded, numbers)]
    return Outcome(result, tables, missed, config)


def score(
    suite: Suite, jobs: list[Job], sequences: Mapping[str, Sequence]
) -> tuple[dict[str, Any], dict[str, list[PoseErrors]]]:
    """Second pass: every measure of every method and sequence, a mean over its seeds.

    Returns the numbers, by method, sequence and measure, and the pose errors behind them, by
    "method/sequence".
    """
    scores: dict[str, Any] = {}
    kept: dict[str, list[PoseErrors]] = {}
    for job in jobs:
        sequence = sequences[job.sequence]
        try:
            loaded = load_predictions(job.path)
            scored = prediction_errors(loaded, sequence, protocol=suite.protocols[0])
        except InputError as error:
            raise FileError(job.path, str(error)) from None
        report = make_report(scored)
        entry = scores.setdefault(job.method.name, {}).setdefault(job.sequence, {"seeds": []})
        entry["seeds"].append(
            {name: getattr(report, name) for name in MEASURES}
            | {"coverage_share": report.coverage_share}
            | {"tracker_fps": 1 / loaded.seconds_per_frame if loaded.seconds_per_frame else None}
            | {f"protocol/{p}": _mean_under(scored, p) for p in suite.protocols}
            | {f"joint/{n}": v for n, v in report.per_joint_mm.items()}
            | {"interval": report.mpjpe_ci95_mm}
        )
        kept.setdefault(f"{job.method.name}/{job.sequence}", []).append(scored)
    for method in scores.values():
        for entry in method.values():
            entry |= _mean_over_seeds(entry["seeds"])
    return scores, kept


def _summary(
    suite: Suite, jobs: list[Job], sequences: Mapping[str, Sequence], absent: list[str],
    numbers: Numbers,
) -> tuple[dict[str, Any], dict[str, Any]]:  # fmt: skip
    """What the run depends on, and its result, JSON-ready."""
    config = {
        "suite": suite.model_dump(mode="json"),
        "sequences": {name: s.manifest.config_sha256 for name, s in sequences.items()},
    }
    return config, config | {
        "scores": numbers.scores,
        "left_out": [s.name for s in suite.sequences if s.name not in sequences] + absent,
        "paper": numbers.rows(suite.rows),
        "predicted_by": sorted({load_description(job)["commit"] or "" for job in jobs}),
    }


def run_studies(suite: Suite, work: Path, again: bool = False) -> None:
    """Run the suite's studies whose results are missing, by their own commands.

    `again` also runs those whose results are of other options or sources.
    """
    for entry in suite.studies:
        path = work / "studies" / f"{entry.name}.json"
        words = [entry.name, *entry.options, "--out", str(path)]
        command = shlex.join(["egocap-eval", *words])
        if path.is_file() and not (again and _differs(path, command)):
            before = load_result(path)["command"]
            if before != command:
                raise FileError(path, f"is of another command: {before}",
                                valid="another --work, or remove it")  # fmt: skip
            continue
        with redirect_stdout(sys.stderr):  # stdout is the suite's, perhaps JSON
            code = main(words)
        if code not in (0, 3) or not path.is_file():
            raise InputError(f"the study '{entry.name}' failed with exit code {code}")


def _differs(path: Path, command: str) -> bool:
    """Whether a study's result is of another command or of other sources."""
    record = load_result(path)
    return (record["command"], record.get("sources")) != (
        command, source_hashes(sources_of(command)))  # fmt: skip


def missed_by_studies(suite: Suite, work: Path) -> list[str]:
    """Targets that the suite's studies missed, in words."""
    return [
        f"{entry.name}: {what}"
        for entry in suite.studies
        for what in load_result(work / "studies" / f"{entry.name}.json")["result"]["missed"]
    ]


def _require_known(suite: Suite) -> None:
    """Raise InputError for unknown studies and settings, before any long work."""
    for entry in suite.studies:
        if entry.name not in STUDIES:
            raise InputError(f"no study '{entry.name}'", valid=STUDIES)
    for method in suite.methods:
        settings(method)


def _refuse_code(suite: Suite, path: Path) -> None:
    """Raise FileError where a suite names a function to import and run."""
    for method in suite.methods:
        source = (method.detections or "").removeprefix("detector:")
        for key, name in (("tracker", method.tracker), ("detections", source)):
            if ":" in name and (key == "tracker" or source != method.detections):
                raise FileError(
                    path, f"names code, '{name}'", key=f"methods.{method.name}.{key}",
                    valid="an installed plug-in, or --allow-code for a suite that you trust",
                )  # fmt: skip


def _require_same_suite(work: Path, suite: Suite) -> None:
    """Write the suite into its folder; FileError for the folder of another suite."""
    path = work / "suite.json"
    if path.is_file():
        before = read_json(path).get("name")
        if before != suite.name:
            raise FileError(path, f"this folder is of the suite '{before}'", valid="another --work")
    write_text(path, suite.model_dump_json(indent=1) + "\n")


def _mean_under(scored: PoseErrors, protocol: str) -> float | None:
    """Mean error under another protocol; None where it is undefined (hips missing)."""
    value = replace(scored, protocol=find_protocol(protocol)).mean()
    return value if np.isfinite(value) else None


def _mean_over_seeds(seeds: list[dict[str, Any]]) -> dict[str, Any]:
    """Mean of every number, and of the errors the spread over seeds too."""
    means: dict[str, Any] = {}
    for name in seeds[0]:
        values = [s[name] for s in seeds]
        if name == "interval":
            means[name] = values[0]
        elif None in values:
            means[name] = None
        else:
            means[name] = float(np.mean(values))
            if len(values) > 1 and name in MEASURES:
                means[f"spread/{name}"] = float(np.std(values, ddof=1))
    return means


def _save_errors(path: Path, scored: Mapping[str, list[PoseErrors]]) -> None:
    """Each frame's mean error over joints and seeds, mm, and the frames' times."""
    arrays: dict[str, Any] = {}
    for name, seeds in scored.items():
        arrays[name] = np.nanmean([s.per_frame for s in seeds], axis=0)
        arrays[f"times/{name}"] = seeds[0].truth.times
    write_npz(path, **arrays)
