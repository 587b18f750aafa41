"""Settings of the command."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from egocap.errors import InputError


@dataclass(frozen=True)
class ForeignOptions:
    """How a trajectory of another program is read."""

    format: str | None = None
    """tum, euroc, colmap, aria, arkit or openxr; recognised when not given."""
    reference: Path | None = None
    """Head poses of the same motion, npz, from which clock, axes, place and scale are found."""
    time_offset: float | None = None
    """Seconds to add to the trajectory's times; found from --reference where that is given."""


@dataclass(frozen=True)
class SfmConfig:
    """How structure from motion sees the pictures."""

    width: int = 640
    """Pictures are reduced to this width, pixels."""
    features: int = 4096
    """Most SIFT features in a picture."""
    every: int = 3
    """Every so many-th frame is adjusted; the poses between two of them are interpolated."""
    overlap: int = 6
    """Such frames after each with which it is compared, and as many 2, 4, 8 and so on away."""

    def __post_init__(self) -> None:
        if min(self.width, self.features, self.every, self.overlap) < 1:
            raise InputError("a setting of the structure from motion below 1", valid="1 or more")
