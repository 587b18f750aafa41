"""Score a track on the sequence it was made from."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.labels import LABELS
from egocap.cameras.rig import Rig
from egocap.data.detections import Detections, load_detections
from egocap.data.input_checks import require_same_times
from egocap.data.plugins import DETECTORS, TRACKERS, Footage, find_plugin
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

OWN_TRACKER = "egocap"


def score_files(
    sequence: Path,
    track: Path | None = None,
    detections: Path | None = None,
    protocol: str = "egocap-17",
    *,
    predictions: Path | None = None,
    missing: Missing = "refuse",
) -> Report:
    """Score a track or predictions file against a sequence's truth, and the detections if given.

    Raises:
        FileError: a file cannot be read, or does not belong to the sequence.
        InputError: neither or both of `track` and `predictions` are given.
    """
    opened = open_sequence(sequence)
    find_protocol(protocol)  # before any file is blamed
    if (track is None) == (predictions is None):
        raise InputError("nothing to score, or too much", valid="one of --track, --predictions")
    if track is not None:
        report, config = _score_track_file(opened, track, protocol)
    else:
        assert predictions is not None
        loaded = load_predictions(predictions)
        with _blamed_on(predictions):
            report = score_predictions(opened, loaded, protocol=protocol, missing=missing)
        config = {"method": loaded.method, "frame": loaded.frame, "unit": loaded.unit}
    if detections is not None:
        found = load_detections(detections)
        with _blamed_on(detections):
            report = with_detections(report, opened, found)
    files = {"sequence": sequence, "track": track, "predictions": predictions,
             "detections": detections}  # fmt: skip
    return replace(
        report,
        provenance={
            **{name: str(path) for name, path in files.items() if path is not None},
            "seed": opened.manifest.seed,
            "content_sha256": opened.manifest.config_sha256,
            "sequence_code_version": opened.manifest.code_version,
            "track_config": config,
        },
    )


def _score_track_file(
    sequence: Sequence, path: Path, protocol: str
) -> tuple[Report, dict[str, object]]:
    tracked = load_track(path)
    content = sequence.manifest.config_sha256
    if tracked.config.get("sequence", content) != content:
        valid = f"a track of {sequence.folder}"
        raise FileError(path, "was made from another sequence", valid=valid)
    with _blamed_on(path):
        return score_track(sequence, tracked, protocol=protocol), tracked.config


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


def score_plugin(
    sequence: Path, tracker: str, detections: str | None = None, protocol: str = "egocap-17"
) -> Report:
    """Run a plugged-in tracker on a sequence, on detections of a source if named, and score it.

    Raises:
        InputError: there is no such plug-in or source, or what it made cannot be scored.
    """
    find_protocol(protocol)
    opened = open_sequence(sequence)
    found = None if detections is None else find_detections(opened, detections)
    result = run_tracker(tracker, opened, found)
    if isinstance(result, Track):
        report = score_track(opened, result, protocol=protocol)
    else:
        report = score_predictions(opened, result, protocol=protocol)
    report = report if found is None else with_detections(report, opened, found)
    provenance = {"sequence": str(sequence), "seed": opened.manifest.seed, "tracker": tracker,
                  "content_sha256": opened.manifest.config_sha256}  # fmt: skip
    return replace(report, method=tracker, provenance=provenance)


def find_detections(sequence: Sequence, source: str) -> Detections:
    """Detections by the name of their source: a file, simulated:..., or detector:PLUG-IN.

    Raises InputError where there is no such source, or it hands back something else.
    """
    from egocap.detect.sources import detections_from

    kind, _, name = source.partition(":")
    if kind != "detector":
        return detections_from(sequence, source, 0)
    found = find_plugin(DETECTORS, name)(Footage(sequence))
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
    footage = Footage(sequence)
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


def _own_tracker(footage: Footage, detections: Detections | None) -> Track:
    from egocap.track.tracker import track

    if detections is None:
        raise InputError("--tracker egocap needs --detections", valid="e.g. simulated:2.0")
    return track(detections, footage.rig, footage.proportions, images=footage.images)


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
def _blamed_on(path: Path) -> Iterator[None]:
    """Name the file in errors about what it holds."""
    try:
        yield
    except InputError as error:
        raise FileError(path, str(error)) from None
