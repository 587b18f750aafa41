"""Options of the command."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class ForeignOptions:
    """How a trajectory of another program is read."""

    format: str | None = None
    """tum, euroc, colmap, aria, arkit or openxr; recognised when not given."""
    reference: Path | None = None
    """Head poses of the same motion, npz, from which clock, axes, place and scale are found."""
    time_offset: float | None = None
    """Seconds to add to the trajectory's times; found from --reference where that is given."""
