"""A motion clip of the 21 simulated bodies, in metres, z up."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from numpy import ndarray as Array


@dataclass(frozen=True, eq=False)
class Clip:
    """A recorded or generated motion on its source skeleton.

    Axis B follows `egocap_sim.core.bodies.BODIES`. `rotations` are the world orientations of the
    source's bone frames, arbitrary at rest; `bone_calibration.calibrate` estimates the offsets.
    A `canonical` clip has body frames instead: all rotations are the identity for a person who
    stands upright facing +x, arms straight down with the palms at the thighs, feet flat and
    pointing forward.
    """

    name: str
    fps: float
    positions: Float[Array, "T B 3"]  # metres, z up, floor near z = 0
    rotations: Float[Array, "T B 3 3"]
    canonical: bool = False
