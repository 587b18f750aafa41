"""A tracked motion and its npz file."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
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
"""Columns of `Track.energies`: the terms of equation 1; joint limits are part of the prior."""

HIDDEN: tuple[str, ...] = ("seen", "out of view", "own body", "object or unknown")
"""Meaning of the codes of `Track.hidden`, as in `Truth.visibility`."""


CONTACTS: tuple[str, ...] = ("left_heel", "left_toe", "right_heel", "right_toe")
"""Columns of `Track.contacts`, in the order of `Truth.contact`."""


@dataclass(frozen=True, eq=False)
class Track:
    """A tracked motion in the head frame and, where the head pose is known, in the world."""

    times: Float[Array, "T"]
    angles: Float[Array, "T 37"]  # radians, `egocap.body.skeleton.DOFS`
    joints_head: Float[Array, "T 18 3"]  # metres, `egocap.body.labels.LABELS`
    energy: Float[Array, "T"]  # final energy of each frame's fit
    converged: Bool[Array, "T"]
    detections_used: Float[Array, "T"]  # number of detections
    seconds_per_frame: float  # solver time, one core
    config: dict[str, object]  # solver and detection settings, time by stage, JSON-ready
    offsets: Float[Array, "22 3"] | None = None  # rest offsets of the tracked skeleton, m
    covariance: Float[Array, "T 18 3 3"] | None = None  # of joints_head, m^2
    confidence: Float[Array, "T 18"] | None = None  # probability that the error is below 5 cm
    energies: Float[Array, "T 4"] | None = None  # by term, `ENERGY_TERMS`
    T_world_head: Float[Array, "T 4 4"] | None = None  # if the head pose is known
    joints_world: Float[Array, "T 18 3"] | None = None  # metres, if the head pose is known
    hidden: UInt8[Array, "T V 18"] | None = None  # why a joint is not visible in a view, `HIDDEN`
    in_world: Bool[Array, "T"] | None = None
    """Frames whose head pose is known; the others have that of the nearest one. None: all."""
    contacts: Float[Array, "T 4"] | None = None  # probability of touching the ground, `CONTACTS`

    def __repr__(self) -> str:
        frames, seconds = len(self.times), float(np.ptp(self.times)) if len(self.times) else 0.0
        frame = "head" if self.joints_world is None else "head and world"
        return (f"Track({frames} frames, {seconds:.1f} s, {int(self.converged.sum())} converged, "
                f"{frame} frame)")  # fmt: skip

    @property
    def standing(self) -> Bool[Array, "T 2"] | None:
        """Whether the left and the right foot stand: a heel or toe probably touches the ground."""
        if self.contacts is None:
            return None
        return np.asarray((self.contacts.reshape(-1, 2, 2) >= 0.5).any(axis=2))

    @property
    def by_frame(self) -> dict[str, Array]:
        """The arrays that hold a value a frame, by name."""
        return {name: value for name, value in vars(self).items()
                if isinstance(value, Array) and name != "offsets"}  # fmt: skip

    def _repr_html_(self) -> str:
        """For notebooks: the summary and, with a covariance, each joint's median uncertainty."""
        summary = f"<p>{escape(repr(self))}</p>"
        if self.covariance is None:
            return summary
        sigma = np.sqrt(np.trace(self.covariance, axis1=2, axis2=3) / 3)  # (T, 18) metres
        rows = "".join(
            f"<tr><td>{label.replace('_', ' ')}</td><td>{1000 * s:.1f}</td></tr>"
            for label, s in zip(LABELS, np.median(sigma, 0), strict=True)
        )
        head = "<tr><th>joint</th><th>standard deviation along an axis, median [mm]</th></tr>"
        return f"{summary}<table>{head}{rows}</table>"


def save_track(path: str | Path, track: Track) -> None:
    """Write a track as npz, atomically."""
    save_record(path, "egocap-track", track)


def load_track(path: str | Path) -> Track:
    """Read a track. FileError names a missing, damaged, misshapen or empty array."""
    found = load_record(path, "egocap-track", Track)
    if not len(found.times):
        raise FileError(path, "holds no frame", key="times", valid="one frame or more")
    if found.hidden is not None and found.hidden.max(initial=0) >= len(HIDDEN):
        raise FileError(path, f"holds the code {found.hidden.max()}", key="hidden",
                        valid=f"0 to {len(HIDDEN) - 1}")  # fmt: skip
    return found


def write_arrays(path: str | Path, track: Track) -> None:
    """Write times, joints, angles and their names as npz for other programs.

    Joints are in metres, in the frame named by `frame` (the world if known, else the head); angles
    in radians; `hidden` indexes `hidden_names`. Raises as `egocap.files.disk_errors`.
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
        in_world=track.in_world,
        contacts=track.contacts,
        contact_names=None if track.contacts is None else np.array(CONTACTS),
        hidden=track.hidden,
        hidden_names=None if track.hidden is None else np.array(HIDDEN),
    )
