"""The 3-D measures by name, one line each; reports, suites and comparisons read this table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from egocap.errors import InputError
from egocap.evaluation import metrics, world_metrics
from egocap.evaluation.pose_errors import MM, PoseErrors
from egocap.evaluation.protocol import BONES, LOWER_LIMBS, UPPER_LIMBS, same_joints

PCK_M = 0.15  # Mehta et al. 2017; FRAME takes 0.10
NAN = float("nan")


@dataclass(frozen=True)
class Measure:
    """A number that a motion is judged by. `compute` gives NaN where nothing can be measured."""

    name: str
    unit: str
    better: Literal["lower", "higher"]
    description: str
    compute: Callable[[PoseErrors], float]


def _pa(e: PoseErrors) -> float:
    rules = same_joints(e.protocol, "similarity")
    return MM * metrics.mean_error(e.under(rules), e.counted) if rules.defined(e.counted) else NAN


def _pck(threshold: float) -> Callable[[PoseErrors], float]:
    return lambda e: metrics.pck(e.joint_errors, e.valid, e.evaluated, threshold)


def _auc(e: PoseErrors) -> float:
    return metrics.auc(e.joint_errors, e.valid, e.evaluated, PCK_M)


def _acceleration(e: PoseErrors) -> float:
    predicted, truth, mask = e.compact()
    return metrics.acceleration_error(predicted, truth, e.truth.times, mask)


def _velocity(e: PoseErrors) -> float:
    predicted, truth, mask = e.compact()
    return metrics.velocity_error(predicted, truth, e.truth.times, mask)


def _bone_drift(e: PoseErrors) -> float:
    drift = metrics.bone_length_drift(e.predicted, BONES, e.valid)
    return MM * float(np.nanmean(drift)) if np.isfinite(drift).any() else NAN


def _bone_error(e: PoseErrors) -> float:
    return MM * metrics.bone_length_error(e.predicted, e.truth.joints_head, BONES, e.valid)


def _visible(e: PoseErrors) -> float:
    return NAN if e.truth.seen is None else e.mean(where=e.truth.seen)


def _hidden(e: PoseErrors) -> float:
    return NAN if e.truth.seen is None else e.mean(where=~e.truth.seen)


MEASURES: Mapping[str, Measure] = {
    m.name: m
    for m in (
        Measure("mpjpe_mm", "mm", "lower", "mean error of the protocol's joints", PoseErrors.mean),
        Measure("pa_mpjpe_mm", "mm", "lower", "after a similarity a frame", _pa),
        Measure("upper_mm", "mm", "lower", "shoulders to hands", lambda e: e.mean(UPPER_LIMBS)),
        Measure("lower_mm", "mm", "lower", "hips to feet", lambda e: e.mean(LOWER_LIMBS)),
        Measure("median_mm", "mm", "lower", "over joints and frames", lambda e: e.percentile(50)),
        Measure("p90_mm", "mm", "lower", "90th percentile", lambda e: e.percentile(90)),
        Measure("p95_mm", "mm", "lower", "95th percentile", lambda e: e.percentile(95)),
        Measure("p99_mm", "mm", "lower", "99th percentile", lambda e: e.percentile(99)),
        Measure("max_mm", "mm", "lower", "worst joint and frame", lambda e: e.percentile(100)),
        Measure("visible_mm", "mm", "lower", "joints seen by at least one camera", _visible),
        Measure("hidden_mm", "mm", "lower", "joints seen by no camera", _hidden),
        Measure("pck3d_100", "%", "higher", "joints within 100 mm", _pck(0.10)),
        Measure("pck3d_150", "%", "higher", "joints within 150 mm", _pck(PCK_M)),
        Measure("auc3d_150", "%", "higher", "area under the 3-D PCK curve to 150 mm", _auc),
        Measure("velocity_error", "m/s", "lower", "mean velocity error", _velocity),
        Measure("accel_error", "m/s^2", "lower", "mean acceleration error: jitter", _acceleration),
        Measure("bone_error_mm", "mm", "lower", "mean error of bone lengths", _bone_error),
        Measure("bone_drift_mm", "mm", "lower", "standard deviation of bone lengths", _bone_drift),
        Measure("foot_skate", "m/s", "lower", "horizontal speed of planted toes",
                world_metrics.skate),
        Measure("penetration_mm", "mm", "lower", "depth of ankles and toes below the ground",
                world_metrics.sinking),
        Measure("contact_f1", "0 to 1", "higher", "planted feet found", world_metrics.contact_f1),
        Measure("world_mpjpe_mm", "mm", "lower", "in its own world, first frame aligned",
                world_metrics.first_aligned),
        Measure("world_aligned_mpjpe_mm", "mm", "lower", "in its own world, all frames aligned",
                world_metrics.all_aligned),
        Measure("root_translation_percent", "% of the way", "lower",
                "mean error of the hips' place, all frames aligned", world_metrics.root_error),
        Measure("world_accel_error", "m/s^2", "lower", "mean acceleration error in its own world",
                world_metrics.acceleration),
    )
}  # fmt: skip


def find_measure(name: str) -> Measure:
    """The measure of that name; InputError lists the names."""
    if name not in MEASURES:
        raise InputError(f"no measure '{name}'", valid=MEASURES)
    return MEASURES[name]


def measure(errors: PoseErrors, name: str) -> float | None:
    """One measure of a motion; None where nothing can be measured."""
    value = float(find_measure(name).compute(errors))
    return value if np.isfinite(value) else None
