"""Settings of a recording of a calibration board."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class BoardCamera:
    """Faults of the cameras that picture a board."""

    blur_px: float = 0.7
    """Standard deviation of the lens blur, pixels."""
    noise: float = 0.008
    """Standard deviation of the noise at white, as a share of white."""
    jpeg: int = 92
    """JPEG quality."""
    shutter_s: float = 0.008
    """Exposure time of a row, seconds."""
    readout_s: float = 0.0
    """Time from the first row's exposure to the last one's, seconds."""
    vignetting: float = 0.35
    """Share of the light lost at the edge of the lens."""
    samples: int = 3
    """Rays along each side of a pixel."""
    exposures: int = 5
    """Poses during the exposure."""


@dataclass(frozen=True)
class BoardRecording:
    """How a board is shown to a rig."""

    count: int = 40
    """Pictures of each camera."""
    seed: int = 0
    """Seed of all random draws."""
    rate: float = 0.0
    """Frames a second while the board moves; 0: one picture at each rest of the hand."""
    lag_s: float = 0.0
    """Delay of all cameras but the first, seconds."""
    bend_m: float = 0.0
    """Height of the board's middle over its left and right edges, metres; 0: flat."""
    camera: BoardCamera = field(default_factory=BoardCamera)
    """Faults of the cameras."""
