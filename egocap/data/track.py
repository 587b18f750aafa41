"""A tracked motion, in memory and as an npz file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from egocap.data.results import Layout, load_result, save_result
from egocap.errors import FileError

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


_LAYOUT: Layout = {
    "times": ("f", ("T",)), "angles": ("f", ("T", 37)), "joints_head": ("f", ("T", 18, 3)),
    "energy": ("f", ("T",)), "converged": ("b", ("T",)), "detections_used": ("f", ("T",)),
    "seconds_per_frame": ("f", ()), "config": ("U", ()), "offsets": ("f", (22, 3)),
    "covariance": ("f", ("T", 18, 3, 3)), "confidence": ("f", ("T", 18)),
    "energies": ("f", ("T", len(ENERGY_TERMS))), "T_world_head": ("f", ("T", 4, 4)),
    "joints_world": ("f", ("T", 18, 3)), "hidden": ("u", ("T", "V", 18)),
}  # fmt: skip


def save_track(path: str | Path, track: Track) -> None:
    """Write a track as npz, whole or not at all."""
    save_result(Path(path), "egocap-track", track)


def load_track(path: str | Path) -> Track:
    """Read a track; FileError names the array that is missing, damaged or of a wrong shape."""
    found = load_result(Path(path), "egocap-track", Track, _LAYOUT)
    if found.hidden is not None and found.hidden.max(initial=0) >= len(HIDDEN):
        raise FileError(path, f"holds the cause {found.hidden.max()}", key="hidden",
                        valid=f"0 to {len(HIDDEN) - 1}")  # fmt: skip
    return found
