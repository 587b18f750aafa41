"""A tracked motion, in memory and as an npz file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from egocap.body.labels import LABELS
from egocap.body.skeleton import DOFS
from egocap.data.arrays import load_record, save_record
from egocap.errors import FileError
from egocap.files import write_npz

ENERGY_TERMS: tuple[str, ...] = ("detection", "prior", "smoothness", "colour")
"""What `Track.energies` holds of every frame: equation 1's terms; the limits count as prior."""

HIDDEN: tuple[str, ...] = ("seen", "out of view", "own body", "object or unknown")
"""What the codes of `Track.hidden` mean; the same as a simulated truth's visibility."""


@dataclass(frozen=True, eq=False)
class Track:
    """A tracked motion in the head frame."""

    times: Float[Array, "T"]
    angles: Float[Array, "T 37"]  # radians, `egocap.body.skeleton.DOFS`
    joints_head: Float[Array, "T 18 3"]  # metres, `egocap.body.labels.LABELS`
    energy: Float[Array, "T"]  # final energy of each frame's fit
    converged: Bool[Array, "T"]
    detections_used: Float[Array, "T"]  # how many detections each frame had
    seconds_per_frame: float  # solver time, one core
    config: dict[str, object]  # solver and detection settings, time by stage, JSON-ready
    offsets: Float[Array, "22 3"] | None = None  # rest offsets of the skeleton that was tracked, m
    covariance: Float[Array, "T 18 3 3"] | None = None  # of joints_head, m^2
    confidence: Float[Array, "T 18"] | None = None  # chance that a joint is within 5 cm, 0 to 1
    energies: Float[Array, "T 4"] | None = None  # by term, `ENERGY_TERMS`
    T_world_head: Float[Array, "T 4 4"] | None = None  # where the head pose is known
    joints_world: Float[Array, "T 18 3"] | None = None  # metres, where the head pose is known
    hidden: UInt8[Array, "T V 18"] | None = None  # why a view does not see a joint, `HIDDEN`

    def __repr__(self) -> str:
        frames, seconds = len(self.times), float(np.ptp(self.times)) if len(self.times) else 0.0
        frame = "head" if self.joints_world is None else "head and world"
        return (f"Track({frames} frames, {seconds:.1f} s, {int(self.converged.sum())} converged, "
                f"{frame} frame)")  # fmt: skip


def save_track(path: str | Path, track: Track) -> None:
    """Write a track as npz, whole or not at all."""
    save_record(path, "egocap-track", track)


def load_track(path: str | Path) -> Track:
    """Read a track; FileError names the array that is missing, damaged or of a wrong shape."""
    found = load_record(path, "egocap-track", Track)
    if found.hidden is not None and found.hidden.max(initial=0) >= len(HIDDEN):
        raise FileError(path, f"holds the cause {found.hidden.max()}", key="hidden",
                        valid=f"0 to {len(HIDDEN) - 1}")  # fmt: skip
    return found


def write_arrays(path: str | Path, track: Track) -> None:
    """Write times, joints, angles and their names as npz, for programs other than this one.

    Joints are in metres, in the world where that is known (`frame` says which), angles in radians;
    `hidden` gives for every view why it does not see a joint, by `hidden_names`. Raises FileError
    or MachineError where the file cannot be written.
    """
    world = track.joints_world is not None
    write_npz(
        Path(path),
        time=track.times,
        joints=track.joints_world if world else track.joints_head,
        joint_names=np.array(LABELS),
        angles=track.angles,
        angle_names=np.array(DOFS),
        frame=np.array("world" if world else "head"),
        confidence=track.confidence,
        T_world_head=track.T_world_head,
        hidden=track.hidden,
        hidden_names=None if track.hidden is None else np.array(HIDDEN),
    )
