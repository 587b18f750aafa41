"""Settings of the import of footage; the command line shows the comments as help."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isfinite

from egocap.errors import InputError
from egocap.media.pictures import PictureOptions


@dataclass(frozen=True)
class Range:
    """Which part of the footage to use."""

    start: float | None = None
    """First time to use, seconds by the first view's file."""
    end: float | None = None
    """Last time to use, seconds by the first view's file."""
    keep_single: bool = False
    """Keep the time before all views have begun and after the first one has ended."""


@dataclass(frozen=True)
class ImportOptions:
    """How the footage is read."""

    side_by_side: bool = False
    """One source holds all views, side by side in the order of the rig."""
    copy: bool = False
    """Copy the pictures into the sequence; otherwise it refers to the files."""
    range: Range = field(default_factory=Range)
    pictures: PictureOptions = field(default_factory=PictureOptions)
    lag: tuple[float, ...] = ()
    """Seconds that the times in each further view's file are ahead of the first's, instead of an
    estimate."""
    drift: tuple[float, ...] = ()
    """Parts per million by which each further view's clock is faster than the first's, instead of
    an estimate."""
    gains: tuple[float, ...] = ()
    """Factors on red, green and blue of each further view that bring its colours to the first's,
    instead of an estimate."""

    def __post_init__(self) -> None:
        for name in ("lag", "drift", "gains"):
            if not all(map(isfinite, getattr(self, name))):
                raise InputError(f"--{name} with a value that is not finite")
        for name, time in (("start", self.range.start), ("end", self.range.end)):
            if time is not None and not isfinite(time):
                raise InputError(f"--{name} {time:g}", valid="seconds")
