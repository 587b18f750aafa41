"""Places by name."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from egocap.errors import InputError
from egocap_sim.environment.grounds import court, grass, outdoor, square, street
from egocap_sim.environment.place import Place, with_bounced_light
from egocap_sim.environment.rooms import chroma, corridor, room, studio

LARGEST_RADIUS_M = 15.0
Rng = np.random.Generator


def make_place(name: str, rng: Rng, clear_radius: float = 2.0) -> Place:
    """Make a place whose meshes stay outside a circle of `clear_radius` metres about the origin.

    The same generator state gives the same place. Raises InputError for an unknown name or a
    radius outside 0.5 to 15 m.
    """
    if name not in PLACES:
        raise InputError(f"unknown place '{name}'", valid=PLACES)
    if not 0.5 <= clear_radius <= LARGEST_RADIUS_M:
        raise InputError(
            f"clear radius is {clear_radius} m", valid=f"0.5 to {LARGEST_RADIUS_M:g} m"
        )
    place = PLACES[name](rng, float(clear_radius))
    return place if place.name == "chroma" else with_bounced_light(place)


def anywhere(rng: Rng, clear_radius: float) -> Place:
    """A random place except the green room."""
    kinds = [k for k in PLACES if k not in ("chroma", "any")]
    return PLACES[kinds[int(rng.integers(len(kinds)))]](rng, clear_radius)


PLACES: dict[str, Callable[[Rng, float], Place]] = {
    "room": room, "studio": studio, "chroma": chroma, "outdoor": outdoor,
    "corridor": corridor, "street": street, "grass": grass, "court": court,
    "square": square, "any": anywhere,
}  # fmt: skip
