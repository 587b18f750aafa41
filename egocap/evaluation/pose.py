"""Scores of a tracked 3-D motion against the true one."""

from __future__ import annotations

import logging

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.labels import LABELS
from egocap.data.input_checks import require_finite, require_same_times, require_shape
from egocap.errors import InputError
from egocap.evaluation import metrics
from egocap.evaluation.ground_truth import Reference
from egocap.evaluation.measures import MEASURES, MM, Scored, measure
from egocap.evaluation.protocol import HIPS, PROTOCOLS, find_protocol
from egocap.evaluation.report import Report

log = logging.getLogger(__name__)

MIN_BLOCKS = 4  # independent stretches of video below which an interval would be a guess


def evaluate_pose(
    predicted: Float[Array, "T 18 3"],
    reference: Reference,
    *,
    predicted_times: Float[Array, "T"] | None = None,
    valid: Bool[Array, "T 18"] | None = None,
    protocol: str = "egocap-17",
    rng: np.random.Generator | None = None,
) -> Report:
    """Score tracked joints against true ones.

    Args:
        predicted: tracked joints in the head frame, metres; labels in `labels.LABELS` order.
        reference: the true ones.
        predicted_times: times of the tracked frames, to check that they are the same ones.
        valid: predicted joints that exist; all, when None. What the others hold is not read.
        protocol: a name in `egocap.evaluation.protocol.PROTOCOLS`.
        rng: draws the bootstrap's samples; the same fixed stream each time when None.

    Raises:
        InputError: frame counts, times or shapes differ, a coordinate is not finite (the message
            says in which frame and joint), nothing is left to score, or there is no such protocol.
    """
    scored = beside_truth(
        predicted, reference, predicted_times=predicted_times, valid=valid, protocol=protocol
    )
    return report_of(scored, rng)


def beside_truth(
    predicted: Float[Array, "T 18 3"],
    reference: Reference,
    *,
    predicted_times: Float[Array, "T"] | None = None,
    valid: Bool[Array, "T 18"] | None = None,
    protocol: str = "egocap-17",
) -> Scored:
    """A motion beside its truth, checked: what every measure is taken from.

    Arguments and errors as of `evaluate_pose`.
    """
    rules = find_protocol(protocol)
    predicted, truth = np.asarray(predicted, np.float64), reference.joints_head
    require_shape(predicted, ("T", len(LABELS), 3), "predicted joints")
    if predicted_times is not None:
        require_same_times(predicted_times, reference.times, "the track")
    if len(predicted) != len(truth):
        raise InputError(
            f"the track has {len(predicted)} frames, the truth {len(truth)}",
            valid="one pose for every frame",
        )
    valid = np.ones(truth.shape[:2], bool) if valid is None else valid
    if valid.shape != truth.shape[:2]:
        raise InputError(f"predicted joints' mask has shape {valid.shape}",
                         valid=str(truth.shape[:2]))  # fmt: skip
    require_finite(predicted, "predicted joints", valid)
    scored = Scored(predicted, truth, reference.times, rules, valid, reference.seen,
                    reference.T_world_head, reference.contact)  # fmt: skip
    if not scored.counted.any():
        raise InputError(f"no joint of {rules.name} was predicted in any frame")
    _require_hips(scored)
    return scored


def report_of(scored: Scored, rng: np.random.Generator | None = None) -> Report:
    """All measures of a motion, its error per joint, under every alignment, and the interval."""
    rules, joints = scored.protocol, list(scored.protocol.joints)
    per_joint = MM * metrics.mean_error_per_joint(scored.errors, scored.counted)
    values = {name: measure(scored, name) for name in MEASURES}
    for name in ("mpjpe_mm", "pa_mpjpe_mm", "median_mm", "p95_mm"):
        assert values[name] is not None, name
    planted = scored.contact is not None and scored.T_world_head is not None
    ideal = Scored(scored.truth, scored.truth, scored.times, rules, np.ones_like(scored.valid),
                   None, scored.T_world_head, scored.contact)  # fmt: skip
    return Report(
        **values,  # type: ignore[arg-type]
        per_joint_mm={LABELS[j]: _number(float(per_joint[j])) for j in joints},
        visible_share=None if scored.seen is None else float(scored.seen[:, joints].mean()),
        coverage_share=float(scored.valid[:, joints].mean()),
        frames=len(scored.truth),
        protocol=rules.name,
        protocol_description=rules.description,
        mpjpe_ci95_mm=_interval(scored, rng),
        other_protocols_mm={
            p.name: MM * metrics.mean_error(scored.errors_under(p), scored.counted)
            for p in PROTOCOLS.values()
            if p.joints == rules.joints and p.name != rules.name
            and (p.alignment != "mid-hip" or _hips_everywhere(scored))
        },
        contact_f1_of_truth=measure(ideal, "contact_f1") if planted else None,
    )  # fmt: skip


def frame_errors(scored: Scored) -> Float[Array, "T"]:
    """Mean error of each frame's counted joints, millimetres; NaN for a frame without any."""
    return MM * metrics.mean_error_per_joint(scored.errors.T, scored.counted.T)


def block_of(times: Float[Array, "T"]) -> int:
    """Frames a second: the length of the blocks that bootstraps draw."""
    return max(1, round(1.0 / float(np.median(np.diff(times))))) if len(times) > 1 else 1


def _interval(scored: Scored, rng: np.random.Generator | None) -> tuple[float, float] | None:
    """95 % interval of the mean error, by blocks of one second; None for too short a video."""
    errors, block = frame_errors(scored), block_of(scored.times)
    errors = errors[np.isfinite(errors)]
    if len(errors) < MIN_BLOCKS * block or len(errors) < 2:
        log.info("no confidence interval: fewer than %d seconds of video", MIN_BLOCKS)
        return None
    rng = np.random.default_rng(0) if rng is None else rng
    return metrics.bootstrap_interval(errors, rng, block=block)


def _hips_everywhere(scored: Scored) -> bool:
    return bool(scored.valid[scored.counted.any(1)][:, HIPS].all())


def _require_hips(scored: Scored) -> None:
    if scored.protocol.alignment == "mid-hip" and not _hips_everywhere(scored):
        raise InputError(
            f"{scored.protocol.name} needs both hips in every frame that has any joint",
            valid="another alignment, e.g. egocap-17-rigid",
        )


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None
