"""Tracks, predictions and detections scored against the labels of a data set's recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.data.detections import Detections
from egocap.data.input_checks import require_same_times
from egocap.data.track import Track
from egocap.datasets.catalogue import DATASETS
from egocap.datasets.recording import Labels, Recording
from egocap.errors import InputError
from egocap.evaluation.detection_scores import DetectionScore, evaluate_detections
from egocap.evaluation.frame_matching import (
    Missing,
    match_frames,
    require_plausible_size,
    to_head_frame,
)
from egocap.evaluation.pose_errors import GroundTruth, PoseErrors
from egocap.evaluation.predictions import Predictions
from egocap.evaluation.protocol import PROTOCOLS, find_protocol
from egocap.evaluation.report import Report
from egocap.evaluation.scoring import make_report

FRAME_BY_FRAME = ("rigid", "similarity", "bone-adjusted", "bones-then-rigid")
"""Alignments under which the frame of reference of the labels does not matter."""


def evaluate_recording(
    result: Track | Predictions | Float[Array, "T 18 3"],
    recording: Recording,
    *,
    protocol: str | None = None,
    detections: Detections | None = None,
    missing: Missing = "refuse",
) -> Report:
    """Score a motion against the labels of the recording that it was made from.

    Joints that the data set does not label do not count.

    Args:
        result: a track, predictions of another method, or joints in the head frame (metres,
            `egocap.body.labels.LABELS`), NaN where a joint was not found.
        recording: a sequence of a data set.
        protocol: a name of `egocap.evaluation.PROTOCOLS`; by default the data set's.
        detections: those that the motion was made from, to score them too.
        missing: "skip" scores predictions that lack some of the frames.

    Raises:
        InputError: the recording has no labels, the result does not belong to it, or it cannot be
            scored under the protocol.
    """
    name = protocol or DATASETS[recording.dataset].protocol
    labels = require_labels(recording)
    if not recording.known_frame and find_protocol(name).alignment not in FRAME_BY_FRAME:
        raise InputError(f"{recording.name}: the labels' frame is unrelated to the camera's",
                         valid="a protocol with -rigid, -pa, -ba or -ba-rigid")  # fmt: skip
    joints, valid = joints_in_head(result, recording, missing)
    truth = GroundTruth(
        labels.joints_head, recording.times, T_world_head=labels.T_world_head,
        labelled=labels.labelled,
    )  # fmt: skip
    if isinstance(result, Predictions):
        known = valid & labels.labelled
        require_plausible_size(joints, known, labels.joints_head, result.unit)
    report = make_report(PoseErrors.between(joints, truth, valid=valid, protocol=name))
    method = result.method if isinstance(result, Predictions) else None
    report = replace(report, method=method or None)
    report = report if recording.known_frame else _without_frame(report)
    return report if detections is None else _with_detections(report, detections, recording)


def joints_in_head(
    result: Track | Predictions | Float[Array, "T 18 3"],
    recording: Recording,
    missing: Missing = "refuse",
) -> tuple[Float[Array, "T 18 3"], Bool[Array, "T 18"]]:
    """Joints of every frame of a recording in its head frame, and which of them exist.

    Raises InputError for a result of other frames.
    """
    if isinstance(result, Track):
        require_same_times(result.times, recording.times, "the track")
        return result.joints_head, np.ones(result.joints_head.shape[:2], bool)
    if not isinstance(result, Predictions):
        result = Predictions.from_joints(result)
    positions, valid = match_frames(result, recording.times, missing)
    labels = recording.labels
    if result.frame == "world" and (labels is None or labels.T_world_head is None):
        raise InputError(f"{recording.name} has no head pose in the world",
                         valid="poses in the frame head or camera:VIEW")  # fmt: skip
    world = np.tile(np.eye(4), (len(recording), 1, 1))
    if labels is not None and labels.T_world_head is not None:
        world = labels.T_world_head
    return to_head_frame(positions, result.frame, recording.rig, world), valid


def score_detections(detections: Detections, recording: Recording) -> DetectionScore:
    """PCK and AUC of detections on the 2-D labels of a recording, as `evaluate_detections`.

    Raises InputError where the recording has no labels, or the detections are of other frames.
    """
    labels = require_labels(recording)
    require_same_times(detections.times, recording.times, "the detections file")
    widths = np.array([camera.width for camera in recording.rig.cameras], float)
    return evaluate_detections(
        detections.points, detections.valid, labels.points, labels.in_view, labels.in_view, widths,
        detections.source or "detections",
    )  # fmt: skip


def require_labels(recording: Recording) -> Labels:
    """The labels. Raises InputError where the data set withholds them."""
    if recording.labels is None:
        raise InputError(f"{recording.name} has no labels to score against",
                         valid="--submission FILE, for the data set's own evaluation")  # fmt: skip
    return recording.labels


def _without_frame(report: Report) -> Report:
    """The report without the measures that need the labels' frame of reference."""
    others = {name: value for name, value in report.other_protocols_mm.items()
              if PROTOCOLS[name].alignment in FRAME_BY_FRAME}  # fmt: skip
    return replace(report, velocity_error=None, accel_error=None, other_protocols_mm=others)


def _with_detections(report: Report, detections: Detections, recording: Recording) -> Report:
    score = score_detections(detections, recording)
    return replace(
        report, detections=score, detections_source=score.source, pck20=score.pck20,
        auc20=score.auc20,
    )  # fmt: skip
