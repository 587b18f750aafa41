"""What the stages hand on: detections and tracks, in memory and as npz files."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Bool, Float
from numpy import ndarray as Array


@dataclass(frozen=True, eq=False)
class Detections:
    """Body parts found in every view, in pixels of the rig's own image size.

    A missing detection has `valid` False; its other values mean nothing.
    """

    times: Float[Array, "T"]  # seconds
    points: Float[Array, "T V 18 2"]  # pixels
    sigma: Float[Array, "T V 18"]  # standard deviation of a point along each axis, pixels
    confidence: Float[Array, "T V 18"]  # 0 to 1
    valid: Bool[Array, "T V 18"]
    source: str  # how they were made, e.g. "simulated:2.0"


@dataclass(frozen=True, eq=False)
class Track:
    """A tracked motion in the head frame."""

    times: Float[Array, "T"]
    angles: Float[Array, "T 37"]  # radians, `egocap.skeleton.DOFS`
    joints_head: Float[Array, "T 18 3"]  # metres, `egocap.labels.LABELS`
    energy: Float[Array, "T"]  # final energy of each frame's fit
    converged: Bool[Array, "T"]
    detections_used: Float[Array, "T"]  # how many detections each frame had
    seconds_per_frame: float  # solver time, one core
    config: dict[str, object]  # solver and detection settings, JSON-ready
