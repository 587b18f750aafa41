"""Detections of body parts in every view, and their npz file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.data.arrays import load_record, save_record
from egocap.errors import FileError
from egocap.files import usable


@dataclass(frozen=True, eq=False)
class Detections:
    """Body parts detected in every view, in pixels of the rig's image size.

    Where `valid` is False there is no detection and the other values are meaningless. A hidden
    joint whose position was estimated is a detection with low `confidence` and large `sigma`.
    """

    times: Float[Array, "T"]  # seconds
    points: Float[Array, "T V 18 2"]  # pixels
    sigma: Float[Array, "T V 18"]  # standard deviation of a point along each axis, pixels
    confidence: Float[Array, "T V 18"]  # visibility probability
    valid: Bool[Array, "T V 18"]  # there is a detection, of a visible or hidden joint
    source: str  # of the detections, e.g. "simulated:2.0"
    modes: Float[Array, "T V 18 K 2"] | None = None  # pixels; most probable first
    mode_weights: Float[Array, "T V 18 K"] | None = None  # 0: no mode; the sum is at most 1

    def __repr__(self) -> str:
        frames, views = self.valid.shape[:2]
        return (f"Detections({frames} frames, {views} views, "
                f"{self.valid.sum() / max(frames, 1):.1f} per frame, {self.source})")  # fmt: skip

    def __getitem__(self, rows: slice) -> Detections:
        """Detections of a range of frames; arrays are views of these."""
        arrays = {name: a[rows] for name, a in vars(self).items() if isinstance(a, np.ndarray)}
        return replace(self, **arrays)

    @property
    def candidates(self) -> tuple[Float[Array, "T V 18 K 2"], Float[Array, "T V 18 K"]]:
        """Modes and weights; without modes, the point with weight 1."""
        if self.modes is None or self.mode_weights is None:
            return self.points[..., None, :], self.valid[..., None].astype(float)
        return self.modes, self.mode_weights


def save_detections(path: str | Path, detections: Detections) -> None:
    """Write detections as npz, atomically."""
    save_record(path, "egocap-detections", detections)


def load_detections(path: str | Path) -> Detections:
    """Read detections. FileError names an array that is missing, damaged, misshapen or has an
    invalid value for a valid detection."""
    found = load_record(path, "egocap-detections", Detections)
    if (found.modes is None) != (found.mode_weights is None):
        raise FileError(path, "has one of 'modes' and 'mode_weights'", valid="both or none")
    modes, weights = found.candidates
    total = np.where(np.isfinite(weights) & (weights >= 0.0), weights, np.inf).sum(-1)
    placed = (usable(modes).all(-1) | ~(weights > 0.0)).all(-1)
    for name, good, valid in (
        ("points", usable(found.points).all(-1), "finite pixels"),
        ("sigma", usable(found.sigma) & (found.sigma >= 0.0), "finite pixels, 0 or more"),
        ("confidence", (found.confidence >= 0.0) & (found.confidence <= 1.0), "0 to 1"),
        ("modes", placed, "finite pixels where the weight is not 0"),
        ("mode_weights", total <= 1.0 + 1e-6, "0 or more, adding up to 1 at most"),
    ):
        bad = np.argwhere(found.valid & ~good)
        if len(bad):
            frame, view, joint = bad[0]
            what = f"invalid for label {joint} in view {view} of frame {frame}"
            raise FileError(path, what, key=name, valid=f"{valid} wherever 'valid' is true")
    return found
