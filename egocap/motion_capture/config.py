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
    head_pose: Path | None = None
    """Head poses, npz with `time` and `T_world_head`; the motion is then in that world, otherwise
    relative to the head."""
    skip_film: bool = False
    """Write no film."""
    accept_swapped: bool = False
    """Go on where the views look exchanged."""
