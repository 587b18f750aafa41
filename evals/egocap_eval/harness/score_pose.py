"""Scores of a track, or of any method's poses, on the sequence they were made from."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from tyro.conf import OmitArgPrefixes, Positional, arg

import egocap
from egocap.body.labels import LABELS
from egocap.data.detections import Detections, load_detections
from egocap.data.input_checks import require_same_times
from egocap.data.plugins import DETECTORS, TRACKERS, SequenceView, find_plugin
from egocap.data.sequence import Sequence, open_sequence
from egocap.data.track import Track, load_track
from egocap.errors import FileError, InputError
from egocap.evaluation.predictions import Predictions, load_predictions
from egocap.evaluation.protocol import find_protocol
from egocap.evaluation.scoring import evaluate, with_detections
from egocap_eval.harness.score_dataset import NO_DATASET, DatasetOptions, score_dataset
from egocap_eval.harness.study import Outcome

OWN_TRACKER = "egocap"


def study(
    sequence: Positional[Annotated[Path | None, arg(metavar="SEQ")]] = None,
    /,
    track: Annotated[Path | None, arg(metavar="FILE")] = None,
    predictions: Annotated[Path | None, arg(metavar="FILE")] = None,
    tracker: Annotated[str | None, arg(metavar="NAME")] = None,
    detections: Annotated[str | None, arg(metavar="SOURCE")] = None,
    protocol: Annotated[str | None, arg(metavar="NAME")] = None,
    missing: Literal["refuse", "skip"] = "refuse",
    dataset: Annotated[DatasetOptions, OmitArgPrefixes] = NO_DATASET,
) -> Outcome:
    """Score a tracked motion, or any method's poses, against the truth of its sequence.

    Args:
        sequence: Folder of the sequence the poses were made from; not with --dataset.
        track: Track file written by `egocap track`.
        predictions: Poses of any method, .npz or .jsonl with joints, unit and frame stated.
        tracker: Run egocap, or a plug-in (an installed one, or MODULE:FUNCTION), and score its
            result.
        detections: File of detections the poses were made from, scored too; with --tracker also
            a source such as simulated:2.0, or detector:PLUG-IN.
        protocol: Joints (egocap-17, egocap-18, unrealego-16, mo2cap2-15), alone or with
            -mid-hip, -rigid, -pa, -sequence, -sequence-rigid, -ba or -ba-rigid for an alignment;
            egocap-17 by default, or the data set's own.
        missing: Refuse or skip frames that the predictions lack.
        dataset: A published data set in place of SEQ.
    """
    given = [path for path in (track, predictions, tracker) if path is not None]
    if len(given) != 1:
        valid = "exactly one of --track, --predictions, --tracker"
        raise InputError(f"{len(given)} results to score", valid=valid)
    if protocol is not None:
        find_protocol(protocol)  # before any file is read
    if dataset.dataset is not None:
        if sequence is not None or tracker is not None:
            valid = "--dataset with --track or --predictions"
            raise InputError("--dataset together with SEQ or --tracker", valid=valid)
        return score_dataset(dataset, track, predictions, detections, protocol, missing)
    if sequence is None:
        raise InputError("no sequence", valid="SEQ, or --dataset NAME:PATH")
    opened, protocol = open_sequence(sequence), protocol or "egocap-17"
    provenance = {"sequence": str(sequence), "seed": opened.manifest.seed,
                  "content_sha256": opened.manifest.config_sha256}  # fmt: skip
    if tracker is not None:
        found = None if detections is None else find_detections(opened, detections)
        result = run_tracker(tracker, opened, found)
        report = evaluate(result, opened, protocol=protocol, detections=found)
        provenance |= {"tracker": tracker}
        report = replace(report, method=tracker, provenance=provenance)
    else:
        path = track or predictions
        assert path is not None
        result = load_track(path) if track is not None else load_predictions(path)
        with _naming(path):
            report = evaluate(result, opened, protocol=protocol, missing=missing)
        if detections is not None:
            found = load_detections(Path(detections))
            with _naming(Path(detections)):
                report = with_detections(report, opened, found)
        files = {"track": track, "predictions": predictions, "detections": detections}
        provenance |= {name: str(path) for name, path in files.items() if path is not None}
        if isinstance(result, Track):
            config = result.config
        else:
            config = {"method": result.method, "frame": result.frame, "unit": result.unit}
        version = {"sequence_code_version": opened.manifest.code_version}
        report = replace(report, provenance=provenance | version | {"track_config": config})
    return Outcome(report.to_dict(), report.tables(), heading=report.heading())


def find_detections(sequence: Sequence, source: str, seed: int = 0) -> Detections:
    """Detections from a source: a file, learned, simulated:... (noise of `seed`), detector:PLUG-IN.

    Raises InputError for an unknown source, or a plug-in that does not return Detections.
    """
    from egocap.detect.sources import detections_from

    kind, _, name = source.partition(":")
    if kind != "detector":
        return detections_from(sequence, source, seed)
    found = find_plugin(DETECTORS, name)(SequenceView(sequence))
    if not isinstance(found, Detections):
        raise InputError(f"detector '{name}' returned a {type(found).__name__}",
                         valid="egocap.data.detections.Detections")  # fmt: skip
    require_same_times(found.times, sequence.times, f"the output of detector '{name}'")
    return found


def run_tracker(
    name: str, sequence: Sequence, detections: Detections | None
) -> Track | Predictions:
    """Run a plug-in tracker (`data.plugins`) on a sequence, without access to the truth.

    Raises:
        InputError: unknown plug-in, or a result that is not poses.
    """
    import time

    method = _own_tracker if name == OWN_TRACKER else find_plugin(TRACKERS, name)
    footage = SequenceView(sequence)
    started = time.perf_counter()
    result = method(footage, detections)
    seconds = (time.perf_counter() - started) / len(footage)
    if isinstance(result, Track | Predictions):
        return result
    joints = np.asarray(result, np.float64)
    if joints.shape != (len(footage), len(LABELS), 3):
        raise InputError(
            f"tracker '{name}' returned an array of shape {joints.shape}",
            valid=f"({len(footage)}, {len(LABELS)}, 3), a Track or Predictions",
        )
    return Predictions.from_joints(joints, name, seconds)


def _own_tracker(footage: SequenceView, detections: Detections | None) -> Track:
    if detections is None:
        raise InputError("--tracker egocap needs --detections", valid="e.g. simulated:2.0")
    return egocap.Tracker(footage.rig, footage.body).track(detections, footage.images)


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Name the file in errors about its content."""
    try:
        yield
    except InputError as error:
        raise FileError(path, str(error)) from None
