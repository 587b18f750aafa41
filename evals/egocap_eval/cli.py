"""The command egocap-eval: what is measured."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg
from tyro.extras import SubcommandApp

from egocap.commandline import run
from egocap.errors import InputError

if TYPE_CHECKING:
    from egocap.evaluation import Report

STUDIES = {
    # command: (module with a function `study`, what `egocap-eval --help` says of it)
    "detector": (
        "egocap_eval.detection.detector",
        "Score the learned detector: PCK, calibration, speed.",
    ),
    "augmentation": (
        "egocap_eval.studies.augmentation",
        "What augmentation of green-screen footage is worth.",
    ),
    "training-set": (
        "egocap_eval.studies.training_set",
        "What fewer people or frames cost the detector.",
    ),
    "visibility": (
        "egocap_eval.studies.visibility",
        "Share of the time each joint is seen, by field of view.",
    ),
    "survival": (
        "egocap_eval.studies.crash_recovery",
        "Kill a generation again and again; it must come out whole.",
    ),
    "dataset": (
        "egocap_eval.harness.dataset_card",
        "Count what a data set holds: people, rigs, joints seen.",
    ),
    "run": ("egocap_eval.harness.run", "Run a suite: sequences, predictions, scores and a report."),
    "compare": (
        "egocap_eval.harness.compare",
        "Say what changed between two runs, and whether beyond noise.",
    ),
    "ablation": (
        "egocap_eval.studies.ablation",
        "Track with one part left out at a time, over people.",
    ),
    "personalised": (
        "egocap_eval.studies.personalised",
        "Fit bodies to a clip of their own, track others.",
    ),
    "runtime": (
        "egocap_eval.studies.runtime",
        "How long detector, solvers and the whole way take.",
    ),
    "stress": (
        "egocap_eval.studies.stress",
        "Track under one growing fault at a time, with error bars.",
    ),
    "stress-rendered": (
        "egocap_eval.studies.stress_rendered",
        "The same for faults of the picture, rendered.",
    ),
    "calibration": (
        "egocap_eval.posterior.calibration",
        "Whether the posterior's regions hold what they claim.",
    ),
    "posterior": (
        "egocap_eval.posterior.sampling",
        "Speed of sampling, and the tracker's error over the bound.",
    ),
    "rig": (
        "egocap_eval.rig_design.rig",
        "What stereo rigs can know: visibility, bounds, tracked error.",
    ),
    "check": (
        "egocap_eval.harness.check",
        "Run the regression guard: a fixed small suite against a baseline.",
    ),
}
"""Studies, imported when called: a new one is one module and one line (see `harness.study`)."""


def pose(
    sequence: Positional[Annotated[Path, arg(metavar="SEQ")]],
    /,
    track: Annotated[Path | None, arg(metavar="FILE")] = None,
    predictions: Annotated[Path | None, arg(metavar="FILE")] = None,
    tracker: Annotated[str | None, arg(metavar="NAME")] = None,
    detections: Annotated[str | None, arg(metavar="SOURCE")] = None,
    protocol: Annotated[str, arg(metavar="NAME")] = "egocap-17",
    missing: Literal["refuse", "skip"] = "refuse",
    json: bool = False,
    markdown: bool = False,
    out: Annotated[Path | None, arg(metavar="FILE")] = None,
) -> None:
    """Score a tracked motion, or any method's poses, against the truth of its sequence.

    Args:
        sequence: Folder of the sequence the poses were made from.
        track: Track file written by `egocap track`.
        predictions: Poses of any method, .npz or .jsonl with joints, unit and frame stated.
        tracker: Run egocap, or a plug-in (an installed one, or MODULE:FUNCTION), and score what
            it makes.
        detections: File of detections the poses were made from, scored too; with --tracker also
            a source such as simulated:2.0, or detector:PLUG-IN.
        protocol: Joints (egocap-17, egocap-18, unrealego-16, mo2cap2-15), alone or with
            -mid-hip, -rigid, -pa, -sequence, -sequence-rigid or -ba for an alignment.
        missing: What to do about frames that the predictions lack.
        json: Print JSON instead of a table.
        markdown: Print Markdown instead of a table.
        out: Write the report there too: .json (with command, commit and machine), .md or .txt.
    """
    from egocap_eval.harness.score_pose import score_files, score_plugin
    from egocap_eval.harness.study import check_output

    check_output(json, markdown, out)
    words = ["egocap-eval", "pose", str(sequence)]
    if tracker is not None:
        if track is not None or predictions is not None:
            raise InputError("--tracker makes what is scored", valid="no --track, --predictions")
        report = score_plugin(sequence, tracker, detections, protocol)
        words += ["--tracker", tracker]
    else:
        found = None if detections is None else Path(detections)
        report = score_files(
            sequence, track, found, protocol, predictions=predictions, missing=missing
        )
        words += ["--track", str(track)] if track else ["--predictions", str(predictions)]
        words += ["--missing", missing] if missing != "refuse" else []
    shown = report.to_json() if json else report.to_markdown() if markdown else report.to_text()
    if out is not None:
        words += ["--detections", str(detections)] if detections else []
        _write(out, report, shlex.join([*words, "--protocol", protocol, "--out", str(out)]))
    print(shown)


def physics(
    motions: Annotated[Path, arg(metavar="DIR")],
    person: int = 0,
    workers: int = 1,
    json: bool = False,
    out: Annotated[Path | None, arg(metavar="FILE")] = None,
) -> int:
    """Retarget and simulate every motion clip of a folder; exit code 3 when a target is missed.

    Args:
        motions: Folder of .bvh and .npz clips.
        person: Seed of the person who moves.
        workers: Processes to use.
        json: Print JSON instead of a table.
        out: Write the result there too: .json (with command, commit and machine) or .txt.
    """
    from egocap.commandline import DONE, MISSED
    from egocap_eval.harness.result_file import save_result, write_text
    from egocap_eval.studies.physics import run_physics

    formats = (".json", ".txt")
    if out is not None and out.suffix not in formats:
        raise InputError(f"--out {out}: no format for '{out.suffix}'", valid=formats)
    report = run_physics(motions, person=person, workers=workers)
    if out is not None and out.suffix == ".json":
        words = ["egocap-eval", "physics", "--motions", str(motions), "--person", str(person)]
        save_result(out, report.to_dict(), shlex.join([*words, "--out", str(out)]))
    elif out is not None:
        write_text(out, report.to_text() + "\n")
    print(report.to_json() if json else report.to_text())
    return MISSED if report.missed() else DONE


def accuracy(
    work: Annotated[Path, arg(metavar="DIR")] = Path("out/accuracy"),
    motions: Annotated[Path | None, arg(metavar="DIR")] = None,
    size: tuple[int, int] = (640, 512),
    seeds: int = 3,
    workers: int = 2,
    json: bool = False,
    markdown: bool = False,
    out: Annotated[Path | None, arg(metavar="FILE")] = None,
) -> int:
    """Track the validation scenes from simulated detections; exit code 3 when a target is missed.

    Args:
        work: Folder of the sequences; made where they are missing.
        motions: Folder with the validation clips bvh/007_05.bvh and npz/basketball_signal_3.npz,
            tracked too when given.
        size: Image width and height in pixels.
        seeds: How many draws of the detections' noise to average over.
        workers: Rendering processes.
        json: Print JSON instead of a table.
        markdown: Print Markdown instead of a table.
        out: Write the result there too, .json (with command, commit and machine).
    """
    from egocap.commandline import DONE, MISSED
    from egocap_eval.harness.result_file import save_result
    from egocap_eval.studies.accuracy import run_accuracy

    if seeds < 1:
        raise InputError(f"{seeds} seeds", valid="1 or more")
    if out is not None and out.suffix != ".json":
        raise InputError(f"--out {out}: no format for '{out.suffix}'", valid=".json")
    report = run_accuracy(work, motions=motions, size=size, seeds=seeds, workers=workers)
    if out is not None:
        words = ["egocap-eval", "accuracy", *(["--motions", str(motions)] if motions else [])]
        words += ["--size", *map(str, size), "--seeds", str(seeds), "--out", str(out)]
        save_result(out, report.to_dict(), shlex.join(words))
    table = report.to_table()
    print(report.to_json() if json else table.markdown() if markdown else table.text())
    for what in report.missed():
        print(f"missed: {what}", file=sys.stderr)
    return MISSED if report.missed() else DONE


def main(args: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    what = "Measure tracks, detections and physics."
    words = sys.argv[1:] if args is None else list(args)
    return run(_with_studies(words), prog="egocap-eval", description=what, args=words)


def _with_studies(words: Sequence[str]) -> SubcommandApp:
    """All commands; of the studies only the one that is called is imported."""
    from egocap_eval.harness.study import as_command

    every = SubcommandApp()
    for command in (pose, physics, accuracy):
        every.command(command)
    for name, (module, summary) in STUDIES.items():
        if words[:1] == [name]:
            study = import_module(module).study
            every.command(name=name)(as_command(study, name, words))
        else:
            every.command(name=name, help=summary)(_not_called)
    return every


def _not_called() -> None:
    raise AssertionError("a study that was not called ran")


def _write(path: Path, report: Report, command: str) -> None:
    from egocap_eval.harness.result_file import save_result, write_text

    if path.suffix == ".json":
        save_result(path, report.to_dict(), command)
    else:
        text = report.to_markdown() if path.suffix == ".md" else report.to_text()
        write_text(path, text + "\n")
