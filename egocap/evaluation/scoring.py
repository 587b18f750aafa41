"""Tracks, predictions or arrays of joints scored against the truth of their sequence."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.labels import LABELS
from egocap.data.detections import Detections
from egocap.data.input_checks import require_same_times
from egocap.data.sequence import Sequence
from egocap.data.track import Track
from egocap.data.truth import VISIBLE, Truth
from egocap.errors import InputError
from egocap.evaluation import metrics
from egocap.evaluation.detection_scores import DetectionScore, evaluate_detections
from egocap.evaluation.frame_matching import (
    Missing,
    match_frames,
    require_plausible_size,
    to_head_frame,
    warn_of_other_readings,
)
from egocap.evaluation.measures import MEASURES, measure
from egocap.evaluation.pose_errors import MM, GroundTruth, PoseErrors, WorldPrediction
from egocap.evaluation.predictions import Predictions
from egocap.evaluation.protocol import PROTOCOLS, find_protocol
from egocap.evaluation.report import Report

log = logging.getLogger(__name__)

MIN_BLOCKS = 4  # blocks of a second in the shortest video that gets a confidence interval


def evaluate(
    result: Track | Predictions | Float[Array, "T 18 3"],
    sequence: Sequence,
    *,
    protocol: str = "egocap-17",
    detections: Detections | None = None,
    missing: Missing = "refuse",
) -> Report:
    """Score a motion against the truth of the sequence that it was made from.

    Args:
        result: a track, predictions of another method, or joints in the head frame (metres,
            `egocap.body.labels.LABELS`), NaN where a joint was not found.
        sequence: a simulated sequence.
        protocol: a name in `egocap.evaluation.protocol.PROTOCOLS`.
        detections: those that the motion was made from, to score them too.
        missing: "skip" scores predictions that lack some of the frames.

    Raises:
        InputError: the result does not belong to this sequence, or it cannot be scored under the
            protocol; the message names the frame and joint where it can.
        FileError: the sequence has no truth.
    """
    if isinstance(result, Track):
        report = _score_track(result, sequence, protocol)
    else:
        if not isinstance(result, Predictions):
            result = Predictions.from_joints(result)
        report = _score_predictions(result, sequence, protocol, missing)
    return report if detections is None else with_detections(report, sequence, detections)


def evaluate_pose(
    predicted: Float[Array, "T 18 3"],
    truth: GroundTruth,
    *,
    valid: Bool[Array, "T 18"] | None = None,
    protocol: str = "egocap-17",
    rng: np.random.Generator | None = None,
    world: WorldPrediction | None = None,
) -> Report:
    """Score joints against true ones of the same frames.

    Args:
        predicted: joints in the head frame, metres, in the order of `labels.LABELS`.
        truth: the true ones.
        valid: predicted joints that exist; all, when None. The others are not read.
        protocol: a name in `egocap.evaluation.protocol.PROTOCOLS`.
        rng: draws the bootstrap's samples; the same fixed stream each time when None.
        world: the motion in a world of the method's own, if it has one.

    Raises:
        InputError: frame counts or shapes differ, a coordinate is not finite (the message names
            frame and joint), nothing is left to score, or there is no such protocol.
    """
    errors = PoseErrors.between(predicted, truth, valid=valid, protocol=protocol, world=world)
    return make_report(errors, rng)


def make_report(errors: PoseErrors, rng: np.random.Generator | None = None) -> Report:
    """All measures of a motion, its error per joint and under every alignment, and the interval."""
    rules, truth, joints = errors.protocol, errors.truth, list(errors.protocol.joints)
    per_joint = MM * metrics.mean_error_per_joint(errors.joint_errors, errors.counted)
    values = {name: measure(errors, name) for name in MEASURES}
    for name in ("mpjpe_mm", "median_mm", "p95_mm"):
        assert values[name] is not None, name
    ideal = PoseErrors(truth.joints_head, truth, rules, np.ones_like(errors.valid))
    return Report(
        **values,  # type: ignore[arg-type]
        per_joint_mm={LABELS[j]: None if np.isnan(per_joint[j]) else float(per_joint[j])
                      for j in joints},
        visible_share=None if truth.seen is None else float(truth.seen[:, joints].mean()),
        coverage_share=float(errors.counted.sum() / errors.evaluated.sum()),
        frames=len(truth.times),
        protocol=rules.name,
        protocol_description=rules.description,
        mpjpe_ci95_mm=_interval(errors, rng),
        other_protocols_mm={
            p.name: MM * metrics.mean_error(errors.under(p), errors.counted)
            for p in PROTOCOLS.values()
            if p.joints == rules.joints and p.name != rules.name
            and p.defined(errors.counted)
        },
        contact_f1_of_truth=measure(ideal, "contact_f1"),
        frames_in_world=None if errors.own_world is None else int(errors.own_world.known.sum()),
    )  # fmt: skip


def prediction_errors(
    predictions: Predictions,
    sequence: Sequence,
    *,
    protocol: str = "egocap-17",
    missing: Missing = "refuse",
) -> PoseErrors:
    """Errors of predictions, matched to the sequence's frames and in the head frame.

    Raises:
        InputError: frames are missing, unknown or repeated, the person's size is implausible, or
            the rig has no such frame of reference.
    """
    truth = sequence.truth
    positions, valid = match_frames(predictions, truth.time, missing)
    require_plausible_size(positions, valid, truth.joints_head, predictions.unit)
    in_head = to_head_frame(positions, predictions.frame, sequence.rig, truth.T_world_head)
    world = None
    if predictions.frame == "world":
        joints = list(find_protocol(protocol).joints)
        world = WorldPrediction(positions, np.asarray(valid[:, joints].all(1)))
    return PoseErrors.between(
        in_head, GroundTruth.from_truth(truth), valid=valid, protocol=protocol, world=world
    )


def with_detections(report: Report, sequence: Sequence, detections: Detections) -> Report:
    """The report with the scores of the detections that the motion was made from.

    Raises:
        InputError: the detections are not of this sequence's frames and views, or one of them is
            not finite.
    """
    truth = sequence.truth
    require_same_times(detections.times, truth.time, "the detections file")
    score = _score_points(
        detections.points, detections.valid, truth, sequence, detections.source or "detections"
    )
    return replace(
        report,
        detections=score, detections_source=score.source, pck20=score.pck20, auc20=score.auc20,
    )  # fmt: skip


def bootstrap_block(times: Float[Array, "T"]) -> int:
    """Frames a second: the length of the blocks that bootstraps draw."""
    return max(1, round(1.0 / float(np.median(np.diff(times))))) if len(times) > 1 else 1


def _score_track(track: Track, sequence: Sequence, protocol: str) -> Report:
    content, truth = sequence.manifest.config_sha256, sequence.truth
    if track.config.get("sequence", content) != content:
        valid = f"a track of {sequence.folder}"
        raise InputError("the track was made from another sequence", valid=valid)
    require_same_times(track.times, truth.time, "the track")
    report = evaluate_pose(
        track.joints_head, GroundTruth.from_truth(truth), protocol=protocol,
        world=world_prediction(track),
    )  # fmt: skip
    pixels, inside = sequence.true_rig.project(track.joints_head)  # (V, T, 18, 2), (V, T, 18)
    source = track.config.get("detections")
    return replace(
        report,
        reprojection=_score_points(np.moveaxis(pixels, 0, 1), np.moveaxis(inside, 0, 1), truth,
                                   sequence, "reprojection"),
        tracker_fps=1.0 / track.seconds_per_frame if track.seconds_per_frame > 0 else None,
        converged_share=float(np.mean(track.converged)),
        detections_source=source if isinstance(source, str) else None,
        body=_body_name(track, sequence),
    )  # fmt: skip


def world_prediction(track: Track) -> WorldPrediction | None:
    """A track's motion in its own world, if it has a head pose."""
    if track.joints_world is None:
        return None
    known = np.ones(len(track.times), bool) if track.in_world is None else track.in_world
    return WorldPrediction(track.joints_world, known, track.contacts)


def _body_name(track: Track, sequence: Sequence) -> str:
    """Whose bones the track has: "true", or as `egocap track --body` named them."""
    if track.offsets is None:
        return "not stated"
    if np.allclose(track.offsets, sequence.body.offsets, atol=1e-6):
        return "true"
    names = {"fit": "fitted", "average": "average"}
    source = str(track.config.get("body", "not the true one"))
    kind, _, rest = source.partition(":")
    return " ".join(filter(None, [names.get(kind, source), rest if kind in names else ""]))


def _score_predictions(
    predictions: Predictions, sequence: Sequence, protocol: str, missing: Missing
) -> Report:
    errors = prediction_errors(predictions, sequence, protocol=protocol, missing=missing)
    truth, seconds = sequence.truth, predictions.seconds_per_frame
    positions, valid = match_frames(predictions, truth.time, missing)
    warnings = warn_of_other_readings(
        positions, valid, truth.joints_head, predictions.frame, sequence.rig, truth.T_world_head
    )
    return replace(
        make_report(errors),
        tracker_fps=None if seconds is None else 1.0 / seconds,
        method=predictions.method or None,
        warnings=tuple(warnings),
    )


def _score_points(
    points: Float[Array, "T V 18 2"], found: Bool[Array, "T V 18"], truth: Truth,
    sequence: Sequence, source: str,
) -> DetectionScore:  # fmt: skip
    widths = np.array([camera.width for camera in sequence.rig.cameras], float)
    seen = truth.visibility == VISIBLE
    return evaluate_detections(
        points, found, truth.joints_2d, truth.in_view, seen, widths, source=source
    )


def _interval(errors: PoseErrors, rng: np.random.Generator | None) -> tuple[float, float] | None:
    """95 % interval of the mean error, by blocks of one second; None for too short a video."""
    means, block = errors.per_frame, bootstrap_block(errors.truth.times)
    means = means[np.isfinite(means)]
    if len(means) < MIN_BLOCKS * block or len(means) < 2:
        log.info("no confidence interval: fewer than %d seconds of video", MIN_BLOCKS)
        return None
    return metrics.bootstrap_interval(means, rng or np.random.default_rng(0), block=block)
