"""Settings of the odometry."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class OdometryConfig:
    """How the head pose is estimated from the pictures."""

    width: int = 640
    """Pictures are reduced to this width, pixels."""
    corners: int = 300
    """Most corners followed in a view."""
    noise_px: float = 0.08
    """Standard deviation of a followed corner, pixels at the reduced width."""
    fewest: int = 25
    """Points on which a pose must rest; with fewer, the frame is a gap."""
    window: int = 8
    """Keyframes that each local bundle adjustment refines."""
    keyframe_move: float = 0.20
    """Metres after which a frame becomes a keyframe."""
    keyframe_turn: float = 10.0
    """Degrees after which a frame becomes a keyframe."""
    self_calibration: bool = True
    """Correct the rig, and find lags and rolling shutters, from the first pictures that move."""
    patience: int = 5
    """Frames without a pose after which the map is given up and a new segment begins."""
