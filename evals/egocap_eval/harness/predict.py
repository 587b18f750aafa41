"""First pass of a suite: make predictions, saved with a description of their inputs.

    PREDICTIONS/METHOD/NAME.S.npz   poses, S the seed of the detections' noise
    PREDICTIONS/METHOD/NAME.S.json  everything they depend on, with its hash, and the commit

A prediction made with other settings or weights, or from another sequence, is refused.
"""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from egocap.commandline import progress
from egocap.data.sequence import Sequence
from egocap.data.track import Track
from egocap.errors import EgocapError, FileError, InputError
from egocap.evaluation.predictions import Predictions, save_predictions
from egocap.pose.config import TrackerConfig
from egocap.schema import read_json
from egocap_eval.harness.result_file import config_hash, git_commit, write_text
from egocap_eval.harness.score_pose import OWN_TRACKER, find_detections, run_tracker
from egocap_eval.harness.sources import source_hashes
from egocap_eval.harness.study_sources import FOOTAGE_TRACKED
from egocap_eval.harness.suite import MethodEntry, Suite

log = logging.getLogger(__name__)

SOURCES = FOOTAGE_TRACKED
"""What a prediction depends on beside its settings."""


@dataclass(frozen=True)
class Job:
    """One prediction of a suite: what it is made from and where it is kept."""

    method: MethodEntry
    sequence: str
    seed: int
    path: Path
    depends: Mapping[str, Any]  # everything its content depends on, JSON-ready


def find_sources(
    suite: Suite, beside: Path, sequences: Mapping[str, Sequence]
) -> tuple[dict[str, str | None], list[str]]:
    """Checksum of the weights that each method's detections come from; None without weights.

    Optional methods whose weights or files are missing are left out with a warning; their names
    are returned second. Raises FileError or MachineError for the others'.
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
    """Every prediction of the suite, for the methods in `sources`."""
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
                    "detections": method.detections, "config": settings(method),
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
            # The description first: a prediction without one would be refused.
            description = {"depends": dict(job.depends), "sha256": config_hash(job.depends),
                           "commit": git_commit(), "sources": source_hashes(SOURCES),
                           "seconds": round(time.perf_counter() - started, 2)}  # fmt: skip
            write_text(_sidecar_path(job), json.dumps(description, indent=1) + "\n")
            save_predictions(job.path, made)
            advance()


def require_same(job: Job) -> None:
    """FileError for a saved prediction that was made with other settings."""
    if not job.depends or not job.path.is_file():
        return
    before = load_description(job)["depends"]
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


def discard_changed(job: Job) -> None:
    """Remove a saved prediction that was made with other settings or other code."""
    if not job.depends or not job.path.is_file():
        return
    before = load_description(job)
    now = {"depends": json.loads(json.dumps(dict(job.depends))), "sources": source_hashes(SOURCES)}
    if any(before.get(key) != value for key, value in now.items()):
        job.path.unlink()


def load_description(job: Job) -> dict[str, Any]:
    """What a saved prediction was made from, and the commit. Raises FileError."""
    if not job.depends:
        return {"depends": {}, "commit": None}
    path = _sidecar_path(job)
    try:
        return read_json(path)
    except FileError:
        raise FileError(path, "not readable; it describes how the predictions were made",
                        valid="remove the predictions to make them again") from None  # fmt: skip


def _sidecar_path(job: Job) -> Path:
    return job.path.with_suffix(".json")


def _short(value: Any) -> str:
    text = json.dumps(value, sort_keys=True)
    return text if len(text) <= 60 else text[:57] + "..."


def settings(method: MethodEntry) -> dict[str, Any]:
    """The tracker's settings in full, so that a changed default counts as a change."""
    if method.tracker != OWN_TRACKER:
        return {}
    names = {"solver", *(field.name for field in fields(TrackerConfig))}
    for name in method.config:
        if name not in names:
            raise InputError(f"method '{method.name}': no setting '{name}'", valid=sorted(names))
    solver, config = _solver_and_config(method)
    return {"solver": solver, **asdict(config)}


def _solver_and_config(method: MethodEntry) -> tuple[Any, TrackerConfig]:
    config = dict(method.config)
    return config.pop("solver", "fast"), TrackerConfig(**config)  # type: ignore[arg-type]


def _predicted(job: Job, sequence: Sequence) -> Predictions:
    from egocap.paper.tracker import make_tracker

    source = job.method.detections
    found = None if source is None else find_detections(sequence, source, job.seed)
    if job.method.tracker == OWN_TRACKER and found is not None:
        solver, config = _solver_and_config(job.method)
        tracker = make_tracker(sequence.rig, sequence.body, solver, config)
        result: Track | Predictions = tracker.track(found, sequence.images)
    else:
        result = run_tracker(job.method.tracker, sequence, found)
    if isinstance(result, Predictions):
        return result
    return Predictions.from_joints(result.joints_head, job.method.name, result.seconds_per_frame)
