"""What a motion is scored against."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.labels import LABELS
from egocap.data.input_checks import require_finite, require_shape
from egocap.data.sequence import VISIBLE, Truth
from egocap.errors import InputError


@dataclass(frozen=True, eq=False)
class Reference:
    """True joints and their times, and what else of the truth measures make use of.

    `seen` splits errors by visibility; `T_world_head` and `contact` are for the measures of the
    feet. Without them those measures are left out. Raises InputError for shapes that differ, a
    coordinate that is not finite, or no frame.
    """

    joints_head: Float[Array, "T 18 3"]  # metres, `egocap.body.labels.LABELS`
    times: Float[Array, "T"]  # seconds
    seen: Bool[Array, "T 18"] | None = None  # by at least one camera
    T_world_head: Float[Array, "T 4 4"] | None = None
    contact: Bool[Array, "T 4"] | None = None  # left foot, left toe, right foot, right toe

    def __post_init__(self) -> None:
        joints = np.asarray(self.joints_head, np.float64)
        object.__setattr__(self, "joints_head", joints)
        object.__setattr__(self, "times", np.asarray(self.times, np.float64))
        require_shape(joints, ("T", len(LABELS), 3), "true joints")
        if not len(joints):
            raise InputError("there is no frame to score", valid="one frame or more")
        if self.seen is not None and self.seen.shape != joints.shape[:2]:
            raise InputError(f"visibility has shape {self.seen.shape}", valid=str(joints.shape[:2]))
        require_finite(joints, "true joints")

    @classmethod
    def of(cls, truth: Truth) -> Reference:
        """All that a sequence's truth says."""
        seen = np.asarray((truth.visibility == VISIBLE).any(1))
        return cls(truth.joints_head, truth.time, seen, truth.T_world_head, truth.contact)
