"""A motion compared with the true one: joint errors under a protocol."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.labels import LABEL_INDEX, LABELS
from egocap.data.input_checks import require_finite, require_shape
from egocap.data.truth import VISIBLE, Truth
from egocap.errors import InputError
from egocap.evaluation import metrics
from egocap.evaluation.protocol import ALIGNMENTS, Protocol, find_protocol
from egocap.geometry import transform

MM = 1e3  # millimetres a metre
FEET = tuple(LABEL_INDEX[f"{side}_{part}"] for side in ("left", "right")
             for part in ("ankle", "foot"))  # fmt: skip
"""The joint over each heel and toe of `GroundTruth.contact`."""
TOES = FEET[1::2]


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """True joints and their times, and the parts of the truth that only some measures need.

    `seen` splits errors by visibility; the foot measures need `T_world_head` and `contact`. A
    measure without its input is left out. Raises InputError for shapes that differ, a coordinate
    that is not finite, times that do not increase, or no frame.
    """

    joints_head: Float[Array, "T 18 3"]  # metres, `egocap.body.labels.LABELS`
    times: Float[Array, "T"]  # seconds
    seen: Bool[Array, "T 18"] | None = None  # by at least one camera
    T_world_head: Float[Array, "T 4 4"] | None = None
    contact: Bool[Array, "T 4"] | None = None  # left foot, left toe, right foot, right toe
    propped: Bool[Array, "T"] | None = None  # by what is not simulated: contacts are not known
    labelled: Bool[Array, "T 18"] | None = None  # joints that the truth has; all, when None

    def __post_init__(self) -> None:
        joints = np.asarray(self.joints_head, np.float64)
        object.__setattr__(self, "joints_head", joints)
        object.__setattr__(self, "times", np.asarray(self.times, np.float64))
        require_shape(joints, ("T", len(LABELS), 3), "true joints")
        if not len(joints):
            raise InputError("there is no frame to score", valid="one frame or more")
        T = len(joints)
        for what, array, shape in (
            ("times", self.times, (T,)), ("visibility", self.seen, (T, len(LABELS))),
            ("the labels' mask", self.labelled, (T, len(LABELS))),
            ("the head poses", self.T_world_head, (T, 4, 4)), ("contacts", self.contact, (T, 4)),
            ("frames propped up", self.propped, (T,)),
        ):  # fmt: skip
            if array is not None and array.shape != shape:
                raise InputError(f"{what} of shape {array.shape}", valid=str(shape))
        if not (np.isfinite(self.times).all() and (np.diff(self.times) > 0).all()):
            raise InputError("true joints at times that do not increase", valid="seconds")
        require_finite(joints, "true joints", self.labelled)

    @classmethod
    def from_truth(cls, truth: Truth) -> GroundTruth:
        """The ground truth of a simulated sequence."""
        seen = np.asarray((truth.visibility == VISIBLE).any(1))
        return cls(
            truth.joints_head, truth.time, seen, truth.T_world_head, truth.contact, truth.propped
        )


@dataclass(frozen=True, eq=False)
class WorldPrediction:
    """What a method says of the motion in a world of its own, z up."""

    joints: Float[Array, "T 18 3"]  # metres
    known: Bool[Array, "T"]  # frames whose head pose it knows
    contacts: Float[Array, "T 4"] | None = None  # probability of contact, as `GroundTruth.contact`


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """A predicted motion, the true one, and the errors between them under one protocol."""

    predicted: Float[Array, "T 18 3"]  # head frame, metres
    truth: GroundTruth
    protocol: Protocol
    valid: Bool[Array, "T 18"]  # joints that were predicted
    own_world: WorldPrediction | None = None

    @classmethod
    def between(
        cls,
        predicted: Float[Array, "T 18 3"],
        truth: GroundTruth,
        *,
        valid: Bool[Array, "T 18"] | None = None,
        protocol: str = "egocap-17",
        world: WorldPrediction | None = None,
    ) -> PoseErrors:
        """Check a motion against its truth and compare them; arguments as of `evaluate_pose`.

        Raises:
            InputError: frame counts or shapes differ, a coordinate is not finite, nothing is left
                to score, or there is no such protocol.
        """
        rules = find_protocol(protocol)
        predicted, expected = np.asarray(predicted, np.float64), truth.joints_head
        require_shape(predicted, ("T", len(LABELS), 3), "predicted joints")
        if len(predicted) != len(expected):
            raise InputError(
                f"the track has {len(predicted)} frames, the truth {len(expected)}",
                valid="one pose for every frame",
            )
        valid = np.ones(expected.shape[:2], bool) if valid is None else valid
        if valid.shape != expected.shape[:2]:
            raise InputError(f"predicted joints' mask has shape {valid.shape}",
                             valid=str(expected.shape[:2]))  # fmt: skip
        require_finite(predicted, "predicted joints", valid)
        if truth.labelled is not None:
            valid = valid & truth.labelled
        errors = cls(predicted, truth, rules, valid, world)
        if not errors.evaluated.any():
            raise InputError(f"the truth has no joint of {rules.name}", valid="labels in 3-D")
        if not errors.counted.any():
            raise InputError(f"no joint of {rules.name} was predicted in any frame")
        if not rules.defined(errors.counted):
            raise InputError(
                f"{rules.name} needs {ALIGNMENTS[rules.alignment].needs}",
                valid="another alignment, e.g. egocap-17",
            )
        return errors

    @cached_property
    def evaluated(self) -> Bool[Array, "T 18"]:
        """The protocol's joints that the truth has, predicted or not."""
        chosen = np.isin(np.arange(len(LABELS)), self.protocol.joints)
        labelled = self.truth.labelled
        return np.broadcast_to(chosen, self.valid.shape) & (True if labelled is None else labelled)

    @cached_property
    def counted(self) -> Bool[Array, "T 18"]:
        """The protocol's joints that were predicted: those that it averages over."""
        return self.evaluated & self.valid

    @cached_property
    def joint_errors(self) -> Float[Array, "T 18"]:
        """Joint errors under the protocol, metres; meaningful where `counted`."""
        return self.under(self.protocol)

    @cached_property
    def per_frame(self) -> Float[Array, "T"]:
        """Mean error of each frame's counted joints, millimetres; NaN for a frame without any."""
        return MM * metrics.mean_error_per_joint(self.joint_errors.T, self.counted.T)

    @cached_property
    def world(self) -> WorldPrediction | None:
        """The motion in its own world, or in the true one by the true head pose."""
        if self.own_world is not None:
            return self.own_world
        if self.truth.T_world_head is None:
            return None
        joints = transform(self.truth.T_world_head, self.predicted)
        return WorldPrediction(joints, np.asarray(self.valid[:, FEET].all(1)))

    @cached_property
    def true_world(self) -> Float[Array, "T 18 3"] | None:
        """True joints in the world, metres."""
        if self.truth.T_world_head is None:
            return None
        return transform(self.truth.T_world_head, self.truth.joints_head)

    def under(self, protocol: Protocol) -> Float[Array, "T 18"]:
        """Joint errors under another protocol, metres."""
        aligned = protocol.align(self.predicted, self.truth.joints_head, self.valid)
        return metrics.joint_errors(aligned, self.truth.joints_head)

    def mean(self, joints: Sequence[int] | None = None, where: Array | None = None) -> float:
        """Mean error in millimetres of counted joints: of all, of `joints`, or within a mask."""
        mask = self.counted if where is None else self.counted & where
        if joints is not None:
            mask = mask & np.isin(np.arange(mask.shape[1]), joints)
        return MM * metrics.mean_error(self.joint_errors, mask)

    def percentile(self, percent: float) -> float:
        """Percentile of counted errors, millimetres."""
        return MM * metrics.percentile(self.joint_errors, percent, self.counted)

    def compact(self) -> tuple[Array, Array, Array]:
        """Predicted joints, truth and mask of the protocol's joints."""
        index = list(self.protocol.joints)
        return self.predicted[:, index], self.truth.joints_head[:, index], self.valid[:, index]
