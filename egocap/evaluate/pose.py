"""Scores of a tracked 3-D motion against the true one."""

from __future__ import annotations

import logging

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.errors import InputError
from egocap.evaluate import metrics
from egocap.evaluate.checks import require_finite, require_same_times, require_shape
from egocap.evaluate.protocol import BONES, LOWER_LIMBS, PROTOCOLS, UPPER_LIMBS, find_protocol
from egocap.evaluate.report import Report
from egocap.labels import LABELS

log = logging.getLogger(__name__)

MM = 1e3  # millimetres a metre
MIN_BLOCKS = 4  # independent stretches of video below which an interval would be a guess


def evaluate_pose(
    predicted: Float[Array, "T 18 3"],
    truth: Float[Array, "T 18 3"],
    times: Float[Array, "T"],
    *,
    predicted_times: Float[Array, "T"] | None = None,
    seen: Bool[Array, "T 18"] | None = None,
    protocol: str = "egocap-17",
    rng: np.random.Generator | None = None,
) -> Report:
    """Score tracked joints against true ones.

    Args:
        predicted: tracked joints in the head frame, metres; labels in `egocap.labels.LABELS` order.
        truth: true joints, likewise.
        times: times of the true frames, seconds.
        predicted_times: times of the tracked frames, to check that they are the same ones.
        seen: joints that at least one camera sees, for `visible_share` and the split by visibility.
        protocol: a name in `egocap.evaluate.protocol.PROTOCOLS`.
        rng: draws the bootstrap's samples; the same fixed stream each time when None.

    Raises:
        InputError: frame counts, times or shapes differ, a coordinate is not finite (the message
            says in which frame and joint), or there is no such protocol.
    """
    rules = find_protocol(protocol)
    predicted, truth = np.asarray(predicted, np.float64), np.asarray(truth, np.float64)
    times = np.asarray(times, np.float64)
    require_shape(truth, ("T", len(LABELS), 3), "true joints")
    require_shape(predicted, ("T", len(LABELS), 3), "predicted joints")
    if not len(truth):
        raise InputError("there is no frame to score", valid="one frame or more")
    if predicted_times is not None:
        require_same_times(predicted_times, times, "the track")
    if len(predicted) != len(truth):
        raise InputError(
            f"the track has {len(predicted)} frames, the truth {len(truth)}",
            valid="one pose for every frame",
        )
    require_finite(predicted, "predicted joints")
    require_finite(truth, "true joints")
    if seen is not None and seen.shape != truth.shape[:2]:
        raise InputError(f"visibility has shape {seen.shape}", valid=str(truth.shape[:2]))

    joints = list(rules.joints)
    errors = MM * metrics.joint_errors(rules.align(predicted, truth), truth)  # (T, 18)
    counted = np.zeros(errors.shape, bool)
    counted[:, joints] = True
    per_joint = metrics.mean_error_per_joint(errors)
    return Report(
        mpjpe_mm=metrics.mean_error(errors, counted),
        pa_mpjpe_mm=_error_under("egocap-17-pa", predicted, truth),
        upper_mm=metrics.mean_error(errors[:, list(UPPER_LIMBS)]),
        lower_mm=metrics.mean_error(errors[:, list(LOWER_LIMBS)]),
        median_mm=metrics.percentile(errors, 50, counted),
        p95_mm=metrics.percentile(errors, 95, counted),
        accel_error=_number(
            metrics.acceleration_error(predicted[:, joints], truth[:, joints], times)
        ),
        per_joint_mm={LABELS[j]: float(per_joint[j]) for j in joints},
        visible_share=None if seen is None else float(seen[:, joints].mean()),
        frames=len(truth),
        protocol=rules.name,
        protocol_description=rules.description,
        mpjpe_ci95_mm=_interval(errors[:, joints].mean(1), times, rng),
        visible_mm=None if seen is None else _number(metrics.mean_error(errors, counted & seen)),
        hidden_mm=None if seen is None else _number(metrics.mean_error(errors, counted & ~seen)),
        max_mm=float(errors[:, joints].max()),
        bone_error_mm=MM * metrics.bone_length_error(predicted, truth, BONES),
        bone_drift_mm=MM * float(metrics.bone_length_drift(predicted, BONES).mean()),
        other_protocols_mm={
            name: _error_under(name, predicted, truth) for name in PROTOCOLS if name != rules.name
        },
    )


def _error_under(name: str, predicted: Array, truth: Array) -> float:
    rules = PROTOCOLS[name]
    errors = metrics.joint_errors(rules.align(predicted, truth), truth)
    return MM * metrics.mean_error(errors[:, list(rules.joints)])


def _interval(
    frame_means: Array, times: Array, rng: np.random.Generator | None
) -> tuple[float, float] | None:
    """95 % interval of the mean error, by blocks of one second; None for too short a video."""
    if len(times) < 2:
        return None
    block = max(1, round(1.0 / float(np.median(np.diff(times)))))
    if len(frame_means) < MIN_BLOCKS * block:
        log.info("no confidence interval: fewer than %d seconds of video", MIN_BLOCKS)
        return None
    rng = np.random.default_rng(0) if rng is None else rng
    return metrics.bootstrap_interval(frame_means, rng, block=block)


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None
