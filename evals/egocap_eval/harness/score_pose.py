"""Scores of a track, or of any method's poses, on the sequence they were made from."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from tyro.conf import Positional, arg

import egocap
from egocap.body.labels import LABELS
from egocap.cameras.rig import Rig
from egocap.data.detections import Detections, load_detections
from egocap.data.input_checks import require_same_times
from egocap.data.plugins import DETECTORS, TRACKERS, SequenceView, find_plugin
from egocap.data.sequence import VISIBLE, Sequence, Truth, open_sequence
from egocap.data.track import Track, load_track
from egocap.errors import FileError, InputError
from egocap.evaluation import (
    DetectionScore,
    Reference,
    Report,
    evaluate_detections,
    evaluate_pose,
    find_protocol,
)
from egocap.evaluation.frame_matching import (
    Missing,
    in_head_frame,
    on_frames,
    require_a_person,
    warn_of_mix_ups,
)
from egocap.evaluation.measures import Scored
from egocap.evaluation.pose import beside_truth, report_of
from egocap.evaluation.predictions import Predictions, load_predictions
from egocap_eval.harness.study import Outcome

OWN_TRACKER = "egocap"


def study(
    sequence: Positional[Annotated[Path, arg(metavar="SEQ")]],
    /,
    track: Annotated[Path | None, arg(metavar="FILE")] = None,
    predictions: Annotated[Path | None, arg(metavar="FILE")] = None,
    tracker: Annotated[str | None, arg(metavar="NAME")] = None,
    detections: Annotated[str | None, arg(metavar="SOURCE")] = None,
    protocol: Annotated[str, arg(metavar="NAME")] = "egocap-17",
    missing: Literal["refuse", "skip"] = "refuse",
) -> Outcome:
    """Score a tracked motion, or any method's poses, against the truth of its sequence.

    Args:
        sequence: Folder of the sequence the poses were made from.
        track: Track file written by `egocap track`.
        predictions: Poses of any method, .npz or .jsonl with joints, unit and frame stated.
        tracker: Run egocap, or a plug-in (an installed one, or MODULE:FUNCTION), and score its
            result.
        detections: File of detections the poses were made from, scored too; with --tracker also
            a source such as simulated:2.0, or detector:PLUG-IN.
        protocol: Joints (egocap-17, egocap-18, unrealego-16, mo2cap2-15), alone or with
            -mid-hip, -rigid, -pa, -sequence, -sequence-rigid or -ba for an alignment.
        missing: What to do about frames that the predictions lack.
    """
    given = [path for path in (track, predictions, tracker) if path is not None]
    if len(given) != 1:
        valid = "exactly one of --track, --predictions, --tracker"
        raise InputError(f"{len(given)} results to score", valid=valid)
    opened = open_sequence(sequence)
    find_protocol(protocol)  # before any file is read
    provenance = {"sequence": str(sequence), "seed": opened.manifest.seed,
                  "content_sha256": opened.manifest.config_sha256}  # fmt: skip
    if tracker is not None:
        report = _score_plugin(opened, tracker, detections, protocol)
        report = replace(report, provenance=provenance | {"tracker": tracker})
    else:
        if track is not None:
            report, config = _score_track_file(opened, track, protocol)
        else:
            assert predictions is not None
            report, config = _score_predictions_file(opened, predictions, protocol, missing)
        if detections is not None:
            found = load_detections(Path(detections))
            with _naming(Path(detections)):
                report = with_detections(report, opened, found)
        files = {"track": track, "predictions": predictions, "detections": detections}
        provenance |= {name: str(path) for name, path in files.items() if path is not None}
        version = {"sequence_code_version": opened.manifest.code_version}
        report = replace(report, provenance=provenance | version | {"track_config": config})
    return Outcome(report.to_dict(), report.tables(), heading=report.heading())


def _score_track_file(
    sequence: Sequence, path: Path, protocol: str
) -> tuple[Report, dict[str, Any]]:
    tracked = load_track(path)
    content = sequence.manifest.config_sha256
    if tracked.config.get("sequence", content) != content:
        valid = f"a track of {sequence.folder}"
        raise FileError(path, "was made from another sequence", valid=valid)
    with _naming(path):
        return score_track(sequence, tracked, protocol=protocol), tracked.config


def _score_predictions_file(
    sequence: Sequence, path: Path, protocol: str, missing: Missing
) -> tuple[Report, dict[str, Any]]:
    loaded = load_predictions(path)
    with _naming(path):
        report = score_predictions(sequence, loaded, protocol=protocol, missing=missing)
    return report, {"method": loaded.method, "frame": loaded.frame, "unit": loaded.unit}


def _score_plugin(
    sequence: Sequence, tracker: str, detections: str | None, protocol: str
) -> Report:
    found = None if detections is None else find_detections(sequence, detections)
    result = run_tracker(tracker, sequence, found)
    if isinstance(result, Track):
        report = score_track(sequence, result, protocol=protocol)
    else:
        report = score_predictions(sequence, result, protocol=protocol)
    report = report if found is None else with_detections(report, sequence, found)
    return replace(report, method=tracker)


def score_predictions(
    sequence: Sequence,
    predictions: Predictions,
    *,
    protocol: str = "egocap-17",
    missing: Missing = "refuse",
) -> Report:
    """Score any method's poses (`egocap.evaluation.predictions`) against a sequence's truth.

    Raises:
        InputError: frames are missing, unknown or there twice, the size is no person's, or the
            frame of reference is none of this rig's.
    """
    placed = place_predictions(sequence, predictions, missing=missing, protocol=protocol)
    seconds = predictions.seconds_per_frame
    return replace(
        report_of(placed),
        tracker_fps=None if seconds is None else 1.0 / seconds,
        detections_source=None,
        method=predictions.method or None,
        warnings=tuple(_doubts(sequence, predictions, missing)),
    )


def place_predictions(
    sequence: Sequence,
    predictions: Predictions,
    *,
    missing: Missing = "refuse",
    protocol: str = "egocap-17",
) -> Scored:
    """Predictions beside the truth of their sequence, in the head frame; errors as above."""
    truth = sequence.truth
    positions, valid = on_frames(predictions, truth.time, missing)
    require_a_person(positions, valid, truth.joints_head, predictions.unit)
    in_head = in_head_frame(positions, predictions.frame, sequence.rig, truth.T_world_head)
    return beside_truth(in_head, Reference.of(truth), valid=valid, protocol=protocol)


def _doubts(sequence: Sequence, predictions: Predictions, missing: Missing) -> list[str]:
    truth = sequence.truth
    positions, valid = on_frames(predictions, truth.time, missing)
    return warn_of_mix_ups(
        positions, valid, truth.joints_head, predictions.frame, sequence.rig, truth.T_world_head
    )


def find_detections(sequence: Sequence, source: str) -> Detections:
    """Detections by the name of their source: a file, simulated:..., or detector:PLUG-IN.

    Raises InputError where there is no such source, or it hands back something else.
    """
    from egocap.detect.sources import detections_from

    kind, _, name = source.partition(":")
    if kind != "detector":
        return detections_from(sequence, source, 0)
    found = find_plugin(DETECTORS, name)(SequenceView(sequence))
    if not isinstance(found, Detections):
        raise InputError(f"detector '{name}' handed back a {type(found).__name__}",
                         valid="egocap.data.detections.Detections")  # fmt: skip
    require_same_times(found.times, sequence.times, f"what detector '{name}' handed back")
    return found


def run_tracker(
    name: str, sequence: Sequence, detections: Detections | None
) -> Track | Predictions:
    """What a plugged-in tracker (`data.plugins`) makes of a sequence; it never meets the truth.

    Raises:
        InputError: there is no such plug-in, or it hands back something else than poses.
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
            f"tracker '{name}' handed back an array of shape {joints.shape}",
            valid=f"({len(footage)}, {len(LABELS)}, 3), a Track or Predictions",
        )
    valid = np.asarray(np.isfinite(joints).all(-1))
    frames = np.arange(len(footage))
    return Predictions(joints, valid, "head", "m", frames, None, name, seconds)


def _own_tracker(footage: SequenceView, detections: Detections | None) -> Track:

    if detections is None:
        raise InputError("--tracker egocap needs --detections", valid="e.g. simulated:2.0")
    return egocap.Tracker(footage.rig, footage.body).track(detections, footage.images)


def score_track(sequence: Sequence, track: Track, *, protocol: str = "egocap-17") -> Report:
    """Score a track against the truth of its sequence, in 3-D and projected back into the views.

    Raises:
        InputError: the track is not of this sequence's frames, or a coordinate is not finite; the
            message says in which frame and joint.
    """
    truth = sequence.truth
    seen = truth.visibility == VISIBLE  # (T, V, 18)
    report = evaluate_pose(
        track.joints_head, Reference.of(truth), predicted_times=track.times, protocol=protocol
    )
    source = track.config.get("detections")
    return replace(
        report,
        reprojection=_score_reprojection(track, truth, sequence.true_rig, seen),
        tracker_fps=1.0 / track.seconds_per_frame if track.seconds_per_frame > 0 else None,
        converged_share=float(np.mean(track.converged)),
        detections_source=source if isinstance(source, str) else None,
    )


def with_detections(report: Report, sequence: Sequence, detections: Detections) -> Report:
    """The report with the scores of the detections that the track was made from.

    Raises:
        InputError: the detections are not of this sequence's frames and views, or one of them is
            not finite.
    """
    truth = sequence.truth
    require_same_times(detections.times, truth.time, "the detections file")
    found = evaluate_detections(
        detections.points,
        detections.valid,
        truth.joints_2d,
        truth.in_view,
        truth.visibility == VISIBLE,
        _widths(sequence.rig),
        source=detections.source or "detections",
    )
    return replace(
        report,
        detections=found,
        detections_source=found.source,
        pck20=found.pck20,
        auc20=found.auc20,
    )


def _score_reprojection(
    track: Track, truth: Truth, rig: Rig, seen: Bool[Array, "T V 18"]
) -> DetectionScore:
    pixels, valid = rig.project(track.joints_head)  # (V, T, 18, 2), (V, T, 18)
    return evaluate_detections(
        np.moveaxis(pixels, 0, 1),
        np.moveaxis(valid, 0, 1),
        truth.joints_2d,
        truth.in_view,
        seen,
        _widths(rig),
        source="reprojection",
    )


def _widths(rig: Rig) -> Float[Array, "V"]:
    return np.array([camera.width for camera in rig.cameras], float)


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Name the file in errors about what it holds."""
    try:
        yield
    except InputError as error:
        raise FileError(path, str(error)) from None
