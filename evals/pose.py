"""Score a track on the sequence it was made from."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.errors import FileError, InputError
from egocap.evaluate import (
    DetectionScore,
    Report,
    evaluate_detections,
    evaluate_pose,
    find_protocol,
)
from egocap.evaluate.checks import require_same_times
from egocap.results import Detections, Track, load_detections, load_track
from egocap.rig import Rig
from egocap.sequence import VISIBLE, Sequence, Truth, open_sequence


def score_files(
    sequence: Path, track: Path, detections: Path | None = None, protocol: str = "egocap-17"
) -> Report:
    """Score a track file, and the detections it came from if given, against a sequence's truth.

    Raises:
        FileError: a file cannot be read, or does not belong to the sequence.
    """
    opened = open_sequence(sequence)
    tracked = load_track(track)
    found = None if detections is None else load_detections(detections)
    find_protocol(protocol)  # before any file is blamed
    made_from = tracked.config.get("sequence", opened.manifest.config_sha256)
    if made_from != opened.manifest.config_sha256:
        raise FileError(track, "was made from another sequence", valid=f"a track of {sequence}")
    with _blamed_on(track):
        report = score_track(opened, tracked, protocol=protocol)
    if found is not None and detections is not None:
        with _blamed_on(detections):
            report = with_detections(report, opened, found)
    files = {"sequence": str(sequence), "track": str(track)}
    files |= {} if detections is None else {"detections": str(detections)}
    return replace(
        report,
        provenance={
            **files,
            "seed": opened.manifest.seed,
            "content_sha256": opened.manifest.config_sha256,
            "sequence_code_version": opened.manifest.code_version,
            "track_config": tracked.config,
        },
    )


def score_track(sequence: Sequence, track: Track, *, protocol: str = "egocap-17") -> Report:
    """Score a track against the truth of its sequence, in 3-D and projected back into the views.

    Raises:
        InputError: the track is not of this sequence's frames, or a coordinate is not finite; the
            message says in which frame and joint.
    """
    truth = sequence.truth
    seen = truth.visibility == VISIBLE  # (T, V, 18)
    report = evaluate_pose(
        track.joints_head,
        truth.joints_head,
        truth.time,
        predicted_times=track.times,
        seen=seen.any(1),
        T_world_head=truth.T_world_head,
        contact=truth.contact,
        protocol=protocol,
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
