"""A motion clip in the simulation's own terms: 21 bodies, metres, z up."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from numpy import ndarray as Array


@dataclass(frozen=True, eq=False)
class Clip:
    """A recorded or made motion on its source skeleton.

    Axis B follows `egocap_sim.bodies.BODIES`. `rotations` are the world orientations of the source's
    bone frames, whatever they are at rest; `retarget` works out the constant offset. When the frames
    are already those of `egocap_sim.bodies` (identity at rest), `canonical` is True.
    """

    name: str
    fps: float
    positions: Float[Array, "T B 3"]  # metres, z up, floor near z = 0
    rotations: Float[Array, "T B 3 3"]
    canonical: bool = False
