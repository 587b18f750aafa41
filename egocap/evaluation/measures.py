"""The 3-D measures by name: one line each. Reports, suites and comparisons know them from here."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.labels import LABEL_INDEX
from egocap.errors import InputError
from egocap.evaluation import foot_contact, metrics
from egocap.evaluation.protocol import BONES, LOWER_LIMBS, UPPER_LIMBS, Protocol, same_joints
from egocap.geometry import transform

MM = 1e3  # millimetres a metre
PCK_M = 0.15  # Mehta et al. 2017; FRAME takes 0.10
TOES = (LABEL_INDEX["left_foot"], LABEL_INDEX["right_foot"])


@dataclass(frozen=True, eq=False)
class Scored:
    """A motion beside its truth under one protocol, and what is derived from both once."""

    predicted: Float[Array, "T 18 3"]  # head frame, metres, as predicted
    truth: Float[Array, "T 18 3"]
    times: Float[Array, "T"]
    protocol: Protocol
    valid: Bool[Array, "T 18"]  # predicted joints that exist
    seen: Bool[Array, "T 18"] | None = None  # by at least one camera
    T_world_head: Float[Array, "T 4 4"] | None = None  # true
    contact: Bool[Array, "T 4"] | None = None  # left foot, left toe, right foot, right toe

    @cached_property
    def counted(self) -> Bool[Array, "T 18"]:
        """Joints that the protocol averages over and that were predicted."""
        of_set = np.zeros(self.truth.shape[:2], bool)
        of_set[:, list(self.protocol.joints)] = True
        return of_set & self.valid

    @cached_property
    def errors(self) -> Float[Array, "T 18"]:
        """Joint errors under the protocol, metres; meaningful where `counted`."""
        return self.errors_under(self.protocol)

    @cached_property
    def feet_world(self) -> Float[Array, "T 2 3"] | None:
        """Predicted toes in the world, with the true head pose."""
        if self.T_world_head is None or not self.valid[:, TOES].all():
            return None
        return transform(self.T_world_head, self.predicted[:, TOES])

    def errors_under(self, protocol: Protocol) -> Float[Array, "T 18"]:
        """Joint errors under another protocol, metres."""
        aligned = protocol.align(self.predicted, self.truth, self.valid)
        return metrics.joint_errors(aligned, self.truth)

    def mean(self, joints: Sequence[int] | None = None, where: Array | None = None) -> float:
        """Mean error in millimetres of counted joints, of some of them or where a mask says."""
        mask = self.counted if where is None else self.counted & where
        if joints is not None:
            only = np.zeros(mask.shape[1], bool)
            only[list(joints)] = True
            mask = mask & only
        return MM * metrics.mean_error(self.errors, mask)

    def percentile(self, percent: float) -> float:
        """Percentile of counted errors, millimetres."""
        return MM * metrics.percentile(self.errors, percent, self.counted)

    def compact(self) -> tuple[Array, Array, Array]:
        """Predicted joints, truth and mask of the protocol's joints."""
        index = list(self.protocol.joints)
        return self.predicted[:, index], self.truth[:, index], self.valid[:, index]


Better = Literal["lower", "higher"]


@dataclass(frozen=True)
class Measure:
    """A number that a motion is judged by. `of` gives NaN where there is nothing to measure."""

    name: str
    unit: str
    better: Better
    words: str
    of: Callable[[Scored], float]


def _pa(scored: Scored) -> float:
    errors = scored.errors_under(same_joints(scored.protocol, "similarity"))
    return MM * metrics.mean_error(errors, scored.counted)


def _pck(threshold: float) -> Callable[[Scored], float]:
    return lambda s: metrics.pck(s.errors, s.valid, _of_set(s), threshold)


def _auc(scored: Scored) -> float:
    return metrics.auc(scored.errors, scored.valid, _of_set(scored), PCK_M)


def _of_set(scored: Scored) -> Array:
    """All joints of the protocol, predicted or not: a missing one is a miss."""
    of_set = np.zeros(scored.truth.shape[:2], bool)
    of_set[:, list(scored.protocol.joints)] = True
    return of_set


def _accel(scored: Scored) -> float:
    predicted, truth, mask = scored.compact()
    return metrics.acceleration_error(predicted, truth, scored.times, mask)


def _velocity(scored: Scored) -> float:
    predicted, truth, mask = scored.compact()
    return metrics.velocity_error(predicted, truth, scored.times, mask)


def _drift(scored: Scored) -> float:
    drift = metrics.bone_length_drift(scored.predicted, BONES, scored.valid)
    return MM * float(np.nanmean(drift)) if np.isfinite(drift).any() else float("nan")


def _bones(scored: Scored) -> float:
    return MM * metrics.bone_length_error(scored.predicted, scored.truth, BONES, scored.valid)


def _skate(scored: Scored) -> float:
    if scored.feet_world is None or scored.contact is None:
        return float("nan")
    return foot_contact.foot_skate(scored.feet_world, scored.contact[:, [1, 3]], scored.times)


def _contact_f1(scored: Scored) -> float:
    if scored.feet_world is None or scored.contact is None or len(scored.times) < 2:
        return float("nan")
    planted = scored.contact[:, [0, 2]] | scored.contact[:, [1, 3]]
    return foot_contact.f1_score(
        foot_contact.estimate_planted(scored.feet_world, scored.times), planted
    )


def _where_seen(scored: Scored, seen: bool) -> float:
    if scored.seen is None:
        return float("nan")
    return scored.mean(where=scored.seen if seen else ~scored.seen)


MEASURES: Mapping[str, Measure] = {
    m.name: m
    for m in (
        Measure("mpjpe_mm", "mm", "lower", "mean error of the protocol's joints", Scored.mean),
        Measure("pa_mpjpe_mm", "mm", "lower", "after a similarity a frame", _pa),
        Measure("upper_mm", "mm", "lower", "shoulders to hands", lambda s: s.mean(UPPER_LIMBS)),
        Measure("lower_mm", "mm", "lower", "hips to feet", lambda s: s.mean(LOWER_LIMBS)),
        Measure("median_mm", "mm", "lower", "over joints and frames", lambda s: s.percentile(50)),
        Measure("p90_mm", "mm", "lower", "90th percentile", lambda s: s.percentile(90)),
        Measure("p95_mm", "mm", "lower", "95th percentile", lambda s: s.percentile(95)),
        Measure("p99_mm", "mm", "lower", "99th percentile", lambda s: s.percentile(99)),
        Measure("max_mm", "mm", "lower", "worst joint and frame", lambda s: s.percentile(100)),
        Measure("visible_mm", "mm", "lower", "joints seen by at least one camera",
                lambda s: _where_seen(s, True)),
        Measure("hidden_mm", "mm", "lower", "joints seen by no camera",
                lambda s: _where_seen(s, False)),
        Measure("pck3d_100", "%", "higher", "joints within 100 mm", _pck(0.10)),
        Measure("pck3d_150", "%", "higher", "joints within 150 mm", _pck(PCK_M)),
        Measure("auc3d_150", "%", "higher", "area under the 3-D PCK curve to 150 mm", _auc),
        Measure("velocity_error", "m/s", "lower", "mean velocity error", _velocity),
        Measure("accel_error", "m/s^2", "lower", "mean acceleration error: jitter", _accel),
        Measure("bone_error_mm", "mm", "lower", "mean error of bone lengths", _bones),
        Measure("bone_drift_mm", "mm", "lower", "standard deviation in time of bone lengths",
                _drift),
        Measure("foot_skate", "m/s", "lower", "horizontal speed of planted toes, head pose true",
                _skate),
        Measure("contact_f1", "0 to 1", "higher", "planted feet found, head pose true",
                _contact_f1),
    )
}  # fmt: skip


def find_measure(name: str) -> Measure:
    """The measure of that name; InputError lists the names."""
    if name not in MEASURES:
        raise InputError(f"no measure '{name}'", valid=MEASURES)
    return MEASURES[name]


def measure(scored: Scored, name: str) -> float | None:
    """One measure of a motion; None where there is nothing to measure."""
    value = float(find_measure(name).of(scored))
    return value if np.isfinite(value) else None
