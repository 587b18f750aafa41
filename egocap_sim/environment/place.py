"""A place: static meshes, light and background colour."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.geometry import unit
from egocap_sim.assets.mesh import Material, Mesh
from egocap_sim.assets.primitives import sheet


@dataclass(frozen=True, eq=False)
class Light:
    """A directional light that casts shadows, and hemispherical ambient light.

    Colours are linear; 1 renders a white surface as a white pixel.
    """

    direction: Float[Array, "3"]  # unit, world, in which light travels
    color: Float[Array, "3"]
    sky: Float[Array, "3"]  # ambient light on surfaces that face `sky_axis`
    ground: Float[Array, "3"]  # and on those that face away
    sky_axis: Float[Array, "3"]  # unit
    spread: float = 0.0093
    """Angular diameter (rad); default the sun's. From 0.03, shadows have penumbrae."""


@dataclass(frozen=True, eq=False)
class Place:
    """The static surroundings of the person; the floor is z = 0."""

    name: str
    meshes: tuple[Mesh, ...]
    light: Light
    background: Float[Array, "3"]  # linear colour where nothing is drawn
    room: Float[Array, "3"] = field(default_factory=lambda: np.full(3, 1000.0))
    """Half the length, half the width and the height of a room around the origin, metres."""
    contact: bool = False
    """Whether the floor is darkened by contact shadows: `egocap_sim.render.contact`."""


GROUNDS = ("floor", "yard", "rug", "court", "pavement")
"""Names of ground meshes."""


def with_bounced_light(place: Place) -> Place:
    """The place with ambient light from below in the colour of its ground."""
    colours = [(m.texture / 255.0) ** 2 for m in place.meshes if m.name in GROUNDS]
    if not colours:
        return place
    light = place.light
    albedo = np.mean([c.mean((0, 1)) for c in colours], axis=0)
    arrives = 0.55 * light.color * max(-float(light.direction[2]), 0.0) + 0.5 * light.sky
    ground = 0.45 * light.ground + 0.55 * albedo * arrives
    return replace(place, light=replace(light, ground=ground))


def at_dusk(place: Place) -> Place:
    """The place with a low red sun, a dim blue sky and dimmer glowing meshes."""
    light = place.light
    flat = light.direction * [1.0, 1.0, 0.0]
    low = unit(flat / max(np.linalg.norm(flat), 1e-9) - [0.0, 0.0, 0.55])
    dim = np.array([0.42, 0.34, 0.40])
    meshes = tuple(
        replace(m, texture=np.round(m.texture * dim).astype(np.uint8)) if m.glows else m
        for m in place.meshes
    )
    light = replace(
        light,
        direction=low,
        color=light.color * [0.62, 0.38, 0.22],
        sky=light.sky * [0.50, 0.52, 0.66],
        ground=light.ground * 0.5,
    )
    return replace(place, meshes=meshes, light=light, background=place.background * dim)


def direction(azimuth: Array | float, elevation: Array | float) -> Float[Array, "3 *n"]:
    """Unit vectors at azimuths and elevations, radians."""
    flat = np.cos(elevation)
    return np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])


def flat(
    name: str,
    corner: tuple[float, float, float],
    size: tuple[float, float],
    material: Material,
    *,
    tiled: bool = True,
    cells: int = 1,
) -> Mesh:
    """A horizontal sheet facing up, `size` (x, y) from the corner of least x and largest y."""
    across, down = (size[0], 0, 0), (0, -size[1], 0)
    return sheet(name, corner, across, down, material, tiled=tiled, cells=cells)


def floor(half: Float[Array, "2"], material: Material, cells: int = 1) -> Mesh:
    """A floor with half extents (x, y) in metres."""
    x, y = half
    return flat("floor", (-x, y, 0), (2 * x, 2 * y), material, cells=cells)
