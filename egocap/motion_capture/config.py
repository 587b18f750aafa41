"""Settings of `mocap`; the command line shows the comments as help."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class MocapOptions:
    """What is known of the wearer, and what to write."""

    height: float | None = None
    """Height of the wearer in metres."""
    body: str | None = None
    """Proportions of the wearer: a file of fit-body, or average:HEIGHT; fitted to the footage by
    default."""
    weights: Path | None = None
    """Detector weights, safetensors; those shipped by default."""
    world: bool = True
    """Find the head's path in the pictures: the wearer then moves through the world, on a floor at
    height 0. Without it, or where the pictures do not tell it, the motion is relative to the
    head."""
    head_pose: Path | None = None
    """Head poses in place of those found in the pictures, npz with `time` and `T_world_head`."""
    self_calibration: bool = True
    """Correct the rig file by what the cameras see of the surroundings: rig.json."""
    skip_film: bool = False
    """Write no film."""
    accept_swapped: bool = False
    """Go on where the views look exchanged."""
