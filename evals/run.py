"""Run a suite in two passes: make sequences and save predictions, then score what was saved.

    OUT/suite.json                     the suite as run, with its hash
    OUT/sequences/NAME/                what was generated
    OUT/predictions/METHOD/NAME.S.npz  poses, S the seed of the detections' noise
    OUT/studies/NAME.json              studies' results
    OUT/scores.json, errors.npz        all numbers; each frame's error, for comparisons
    OUT/report.html, .md               the report

What is there is not made again. A prediction records the hash of all it depends on; one that was
made with other settings, or from another sequence, is refused rather than mixed in.
"""

from __future__ import annotations

import json
import logging
import shlex
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import Positional, arg

from egocap.commandline import progress
from egocap.errors import EgocapError, FileError, InputError
from egocap.evaluate.measures import MEASURES, Scored
from egocap.evaluate.pose import frame_errors, report_of
from egocap.evaluate.predictions import Predictions, load_predictions, save_predictions
from egocap.evaluate.protocol import find_protocol
from egocap.results import Track
from egocap.sequence import Sequence, open_sequence
from evals.pose import OWN_TRACKER, find_detections, place_predictions, run_tracker
from evals.record import config_hash, git_commit, load_result, save_result, write_text
from evals.study import Outcome
from evals.suite import MethodEntry, SequenceEntry, Suite, find_suite, load_suite
from evals.verdicts import Numbers, missed_thresholds, paper_table, summary_tables

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Job:
    """One prediction of a suite: what it is made from and where it is kept."""

    method: MethodEntry
    sequence: str
    seed: int
    path: Path
    depends: Mapping[str, Any]  # everything its content depends on, JSON-ready


def study(
    suite: Positional[Annotated[str, arg(metavar="SUITE")]],
    /,
    work: Annotated[Path | None, arg(metavar="DIR")] = None,
    motions: Annotated[Path | None, arg(metavar="DIR")] = None,
    workers: int = 2,
    html: bool = True,
) -> Outcome:
    """Run a suite: make what is missing, save predictions, score them, report; exit code 3 when a
    threshold is missed.

    Args:
        suite: Name of a built-in suite (quick), or a .toml file.
        work: Folder for sequences, predictions and the report; out/SUITE by default.
        motions: Folder of motion clips, for the sequences that need one.
        workers: Rendering processes.
        html: Write report.html and report.md too.
    """
    path = find_suite(suite)
    loaded = load_suite(path)
    _check(loaded)
    work = Path("out") / loaded.name if work is None else work
    _lock(work, loaded)
    sequences = prepare_sequences(loaded, path.parent, work, motions, workers)
    sources, absent = find_sources(loaded, path.parent, sequences)
    jobs = list(plan(loaded, sequences, path.parent, work, sources))
    for job in jobs:  # all of them before any long work
        _require_same(job)
    run_studies(loaded, work)
    predict(jobs, sequences)
    scores, scored = score(loaded, jobs, sequences)
    numbers = Numbers(scores, work / "studies")
    missed = missed_thresholds(loaded, numbers) + missed_by_studies(loaded, work)
    result = {
        "suite": loaded.model_dump(mode="json"),
        "scores": scores,
        "sequences": {name: s.manifest.config_sha256 for name, s in sequences.items()},
        "left_out": [s.name for s in loaded.sequences if s.name not in sequences] + absent,
        "paper": numbers.rows(loaded.rows),
        "predicted_by": sorted({_sidecar(job)["commit"] or "" for job in jobs}),
    }
    tables = [*summary_tables(loaded, numbers), *paper_table(loaded, numbers)]
    config = {"suite": loaded.model_dump(mode="json"), "sequences": result["sequences"]}
    save_result(work / "scores.json", {**result, "missed": missed},
                shlex.join(["egocap-eval", "run", suite]), config=config)  # fmt: skip
    _save_errors(work / "errors.npz", scored)
    if html:
        from evals.report.page import write_report

        write_report(work, loaded, result, missed, scored, sequences)
    return Outcome(result, tables, missed, config)


def prepare_sequences(
    suite: Suite, beside: Path, work: Path, motions: Path | None, workers: int
) -> dict[str, Sequence]:
    """Open every sequence, generated where it is missing. Those that need motions are left out
    without them, with a warning."""
    from egocap_sim.record import generate

    found = {}
    for entry in suite.sequences:
        if entry.folder is not None:
            found[entry.name] = open_sequence(beside / entry.folder)
            continue
        if entry.motion is not None and motions is None:
            log.warning("%s is left out: it needs --motions", entry.name)
            continue
        scene = _scene(entry, beside, motions)
        folder = work / "sequences" / entry.name
        with progress(entry.name, scene.frames) as advance:
            generate(scene, folder, workers=workers, on_frames=advance)
        found[entry.name] = open_sequence(folder)
    return found


def find_sources(
    suite: Suite, beside: Path, sequences: Mapping[str, Sequence]
) -> tuple[dict[str, str | None], list[str]]:
    """What each method's detections come from, beyond their name: the checksum of weights.

    Optional methods whose weights or files are missing are left out, with a warning; second come
    their names. Raises FileError or MachineError for the others'.
    """
    from egocap.detect.weights import open_weights

    sources: dict[str, str | None] = {}
    absent = []
    for method in suite.methods:
        try:
            kind, _, name = (method.detections or "").partition(":")
            sources[method.name] = open_weights(name or None).sha256 if kind == "learned" else None
            for sequence in sequences if method.predictions else ():
                path = beside / str(method.predictions).format(sequence=sequence)
                if not path.is_file():
                    raise FileError(path, "no such file of predictions")
        except EgocapError as error:
            if not method.optional:
                raise
            sources.pop(method.name, None)
            absent.append(method.name)
            log.warning("%s is left out: %s", method.name, error)
    return sources, absent


def plan(
    suite: Suite,
    sequences: Mapping[str, Sequence],
    beside: Path,
    work: Path,
    sources: Mapping[str, str | None],
) -> Iterator[Job]:
    """Every prediction the suite asks for, of the methods that `sources` names."""
    for method in suite.methods:
        if method.name not in sources:
            continue
        for name, sequence in sequences.items():
            content = sequence.manifest.config_sha256
            if method.predictions is not None:
                path = beside / method.predictions.format(sequence=name)
                yield Job(method, name, 0, path, {})
                continue
            for seed in range(method.seeds):
                path = work / "predictions" / method.name / f"{name}.{seed}.npz"
                depends = {
                    "sequence": content, "seed": seed, "tracker": method.tracker,
                    "detections": method.detections, "config": _settings(method),
                    "weights": sources[method.name],
                }  # fmt: skip
                yield Job(method, name, seed, path, depends)


def predict(jobs: list[Job], sequences: Mapping[str, Sequence]) -> None:
    """First pass: save what is missing."""
    waiting = [job for job in jobs if not job.path.is_file() and job.depends]
    if not waiting:
        return
    with progress("predictions", len(waiting), unit="files") as advance:
        for job in waiting:
            started = time.perf_counter()
            made = _predicted(job, sequences[job.sequence])
            job.path.parent.mkdir(parents=True, exist_ok=True)
            # beside it first: a prediction without its description would be refused
            description = {"depends": dict(job.depends), "sha256": config_hash(job.depends),
                           "commit": git_commit(),
                           "seconds": round(time.perf_counter() - started, 2)}  # fmt: skip
            write_text(_sidecar_path(job), json.dumps(description, indent=1) + "\n")
            save_predictions(job.path, made)
            advance()


def score(
    suite: Suite, jobs: list[Job], sequences: Mapping[str, Sequence]
) -> tuple[dict[str, Any], dict[str, list[Scored]]]:
    """Second pass: every measure of every method and sequence, a mean over its seeds.

    Returns the numbers, by method, sequence and measure, and what they were taken from, by
    "method/sequence".
    """
    scores: dict[str, Any] = {}
    kept: dict[str, list[Scored]] = {}
    for job in jobs:
        sequence = sequences[job.sequence]
        try:
            loaded = load_predictions(job.path)
            scored = place_predictions(sequence, loaded, protocol=suite.protocols[0])
        except InputError as error:
            raise FileError(job.path, str(error)) from None
        report = report_of(scored)
        entry = scores.setdefault(job.method.name, {}).setdefault(job.sequence, {"seeds": []})
        entry["seeds"].append(
            {name: getattr(report, name) for name in MEASURES}
            | {"coverage_share": report.coverage_share}
            | {"tracker_fps": 1 / loaded.seconds_per_frame if loaded.seconds_per_frame else None}
            | {f"protocol/{p}": _under(scored, p) for p in suite.protocols}
            | {f"joint/{n}": v for n, v in report.per_joint_mm.items()}
            | {"interval": report.mpjpe_ci95_mm}
        )
        kept.setdefault(f"{job.method.name}/{job.sequence}", []).append(scored)
    for method in scores.values():
        for entry in method.values():
            entry |= _mean_over_seeds(entry["seeds"])
    return scores, kept


def run_studies(suite: Suite, work: Path) -> None:
    """The suite's studies by their own commands, where their results are not there yet."""
    from evals.cli import main

    for entry in suite.studies:
        path = work / "studies" / f"{entry.name}.json"
        words = [entry.name, *entry.options, "--out", str(path)]
        if path.is_file():
            before = load_result(path)["command"]
            if before != shlex.join(["egocap-eval", *words]):
                raise FileError(path, f"is of another command: {before}",
                                valid="another --work, or remove it")  # fmt: skip
            continue
        with redirect_stdout(sys.stderr):  # what the suite itself prints may be JSON
            code = main(words)
        if code not in (0, 3) or not path.is_file():
            raise InputError(f"the study '{entry.name}' failed with exit code {code}")


def missed_by_studies(suite: Suite, work: Path) -> list[str]:
    """Targets that the suite's studies missed, in words."""
    return [
        f"{entry.name}: {what}"
        for entry in suite.studies
        for what in load_result(work / "studies" / f"{entry.name}.json")["result"]["missed"]
    ]


def _check(suite: Suite) -> None:
    """InputError for studies and settings that are not there, before any long work."""
    from evals.cli import STUDIES

    for entry in suite.studies:
        if entry.name not in STUDIES:
            raise InputError(f"no study '{entry.name}'", valid=STUDIES)
    for method in suite.methods:
        _settings(method)


def _lock(work: Path, suite: Suite) -> None:
    """Remember the suite a folder is of; another suite's folder is refused."""
    path = work / "suite.json"
    if path.is_file():
        before = json.loads(path.read_text(encoding="utf-8")).get("name")
        if before != suite.name:
            raise FileError(path, f"this folder is of the suite '{before}'", valid="another --work")
    write_text(path, suite.model_dump_json(indent=1) + "\n")


def _require_same(job: Job) -> None:
    """FileError for a saved prediction that was made with other settings."""
    if not job.depends or not job.path.is_file():
        return
    before = _sidecar(job)["depends"]
    now = json.loads(json.dumps(dict(job.depends)))
    if before != now:
        keys = [k for k in {**before, **now} if before.get(k) != now.get(k)]
        changes = "; ".join(
            f"{k} was {_short(before.get(k))}, is {_short(now.get(k))}" for k in keys
        )
        raise FileError(
            job.path, f"made with another configuration: {changes}",
            valid="another --work, or remove the old predictions to make them again",
        )  # fmt: skip


def _sidecar(job: Job) -> dict[str, Any]:
    if not job.depends:
        return {"depends": {}, "commit": None}
    path = _sidecar_path(job)
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        raise FileError(path, "cannot be read, so nobody knows how the predictions were made",
                        valid="remove the predictions to make them again") from None  # fmt: skip


def _sidecar_path(job: Job) -> Path:
    return job.path.with_suffix(".json")


def _short(value: Any) -> str:
    text = json.dumps(value, sort_keys=True)
    return text if len(text) <= 60 else text[:57] + "..."


def _settings(method: MethodEntry) -> dict[str, Any]:
    """The tracker's settings in full, so that a changed default counts as a change."""
    from dataclasses import asdict, fields

    from egocap.track.config import TrackerConfig

    if method.tracker != OWN_TRACKER:
        return {}
    names = {field.name for field in fields(TrackerConfig)}
    for name in method.config:
        if name not in names:
            raise InputError(f"method '{method.name}': no setting '{name}'", valid=sorted(names))
    return asdict(TrackerConfig(**method.config))  # type: ignore[arg-type]


def _predicted(job: Job, sequence: Sequence) -> Predictions:
    from egocap.cli import detections_from
    from egocap.track.config import TrackerConfig
    from egocap.track.tracker import track

    source = job.method.detections
    simulated = source is not None and source.startswith("simulated")
    found = None
    if source is not None:
        found = (detections_from(sequence, source, job.seed) if simulated
                 else find_detections(sequence, source))  # fmt: skip
    if job.method.tracker == OWN_TRACKER and found is not None:
        config = TrackerConfig(**job.method.config)  # type: ignore[arg-type]
        result: Track | Predictions = track(found, sequence.rig, sequence.proportions, config)
    else:
        result = run_tracker(job.method.tracker, sequence, found)
    if isinstance(result, Predictions):
        return result
    return Predictions(
        result.joints_head, np.ones(result.joints_head.shape[:2], bool), "head", "m",
        np.arange(len(result.times)), None, job.method.name, result.seconds_per_frame,
    )  # fmt: skip


def _scene(entry: SequenceEntry, beside: Path, motions: Path | None) -> Any:
    from egocap_sim.builtin import builtin_file
    from egocap_sim.scene import load_scene
    from egocap_sim.stage import frames_of_clip

    assert entry.scene is not None
    own = entry.scene.endswith(".toml")
    scene = load_scene(beside / entry.scene if own else builtin_file("scene", entry.scene))
    if entry.motion is not None:
        assert motions is not None
        path = motions / entry.motion
        if not path.is_file():
            raise FileError(path, "no such clip", valid="the file under --motions")
        scene = scene.model_copy(update={"motion": type(scene.motion)(file=str(path.resolve()))})
        most = frames_of_clip(scene)
        scene = scene.model_copy(update={"frames": min(entry.frames or most, most)})
    elif entry.frames is not None:
        scene = scene.model_copy(update={"frames": entry.frames})
    if entry.size is not None:
        rig = scene.rig.model_copy(update={"size": entry.size})
        scene = scene.model_copy(update={"rig": rig})
    return scene.model_copy(update={"name": entry.name})


def _under(scored: Scored, protocol: str) -> float | None:
    """Mean error under another protocol; None where it cannot be had (hips missing)."""
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


def _save_errors(path: Path, scored: Mapping[str, list[Scored]]) -> None:
    """Each frame's mean error of the first seed's predictions, mm, and the frames' times."""
    import io

    from egocap.sequence_writer import write_atomically

    arrays: dict[str, Any] = {}
    for name, seeds in scored.items():
        arrays[name] = np.nanmean([frame_errors(s) for s in seeds], axis=0)
        arrays[f"times/{name}"] = seeds[0].times
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)
    write_atomically(path, content.getvalue())
