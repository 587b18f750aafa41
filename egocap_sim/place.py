"""Where a scene happens: floor, walls, furniture, light and sky, all drawn from one generator."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.mesh import Mesh


@dataclass(frozen=True, eq=False)
class Light:
    """One distant main light that throws shadows, and ambient light from above and below.

    Colours are linear, 1 being what turns a white surface into a white pixel.
    """

    direction: Float[Array, "3"]  # unit, world, the way the light travels
    color: Float[Array, "3"]
    sky: Float[Array, "3"]  # ambient light on surfaces that face `sky_axis`
    ground: Float[Array, "3"]  # and on those that face away
    sky_axis: Float[Array, "3"]  # unit


@dataclass(frozen=True, eq=False)
class Place:
    """Everything around the person, at rest in the world; the floor is z = 0."""

    name: str
    meshes: tuple[Mesh, ...]
    light: Light
    background: Float[Array, "3"]  # linear colour where nothing is drawn
