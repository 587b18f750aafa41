"""A person: rest joints, surface, clothes and mass, ready for physics and for drawing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from jaxtyping import Float, Int
from numpy import ndarray as Array

from egocap_sim.assets.mesh import Actor


@dataclass(frozen=True, eq=False)
class Person:
    """One simulated person at rest: standing on z = 0 at the origin, facing +x, arms low (A-pose).

    `landmarks` maps each of the 18 detection labels to its offset, in metres, in the frame of its
    body (`bodies.LABEL_BODY`); joint labels are at the origin, 'head' is the centre of the
    skull, 'left_hand' the knuckle of the middle finger, 'left_foot' the ball of the foot.
    """

    name: str
    height_m: float
    mass_kg: float
    joints: Float[Array, "21 3"]  # rest positions of the bodies' joints, world
    landmarks: Mapping[str, Float[Array, "3"]]
    body_vertices: Float[Array, "N 3"]  # bare skin at rest, for physics geoms and truth checks
    body_owner: Int[Array, "N"]  # body with the largest weight at each bare vertex
    actor: Actor  # all meshes: visible skin, clothes, hair, headgear
    description: Mapping[str, object]  # phenotype, skin, garments, fabrics: JSON-ready
