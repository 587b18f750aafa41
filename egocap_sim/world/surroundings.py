"""Make a scene's place and props."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.errors import InputError
from egocap_sim.core.rng import make_rng
from egocap_sim.scene.config import PlaceTable, ThingTable
from egocap_sim.scene.scene_error import errors_name_key

if TYPE_CHECKING:
    from egocap_sim.assets.mesh import AnimatedActor
    from egocap_sim.environment.place import Place
    from egocap_sim.props.performance import Performance

_MARGIN_M = 0.3  # between the outermost joint and furniture


def check_place(table: PlaceTable) -> None:
    """Raise InputError for an unknown place, FileError for an image that cannot be read.

    Much faster than making the place.
    """
    from egocap_sim.environment.places import PLACES

    if table.name not in PLACES:
        raise InputError(f"unknown place '{table.name}'", valid=PLACES)
    if table.textures is not None:
        from egocap_sim.environment.texture_folder import picture_files, read_picture

        for path in picture_files(Path(table.textures)):
            read_picture(path)
    if table.panorama is not None:
        from egocap_sim.environment.panorama import read_panorama

        read_panorama(Path(table.panorama))


def radius_around(T_world_body: Float[Array, "T 21 4 4"], table: PlaceTable) -> float:
    """Radius around the origin that contains a motion, at least the table's [m].

    Raises InputError for a motion that leaves the largest place; the green one has no walls.
    """
    from egocap_sim.environment.places import LARGEST_RADIUS_M

    reach = float(np.linalg.norm(T_world_body[..., :2, 3], axis=-1).max()) + _MARGIN_M
    if reach > LARGEST_RADIUS_M and table.name != "chroma":
        raise InputError(
            f"the wearer moves {reach - _MARGIN_M:.1f} m away from the origin, out of the place "
            f"'{table.name}'",
            valid=f"up to {LARGEST_RADIUS_M - _MARGIN_M:g} m, or the place 'chroma'",
        )
    return max(table.clear_radius, min(reach, LARGEST_RADIUS_M))


def build_place(table: PlaceTable, seed: int, clear_radius: float) -> Place:
    """Make the place with the textures, panorama and light of the table.

    `clear_radius` [m] around the origin stays free.
    """
    from egocap_sim.environment.place import at_dusk
    from egocap_sim.environment.places import make_place
    from egocap_sim.environment.texture_folder import picture_files, with_pictures

    place = make_place(table.name, make_rng(seed, "place"), clear_radius=clear_radius)
    if table.textures is not None:
        files = picture_files(Path(table.textures))
        place = with_pictures(place, files, make_rng(seed, "textures"))
    if table.panorama is not None:
        from egocap_sim.environment.panorama import read_panorama, with_panorama

        place = with_panorama(place, read_panorama(Path(table.panorama)))
    place = replace(place, contact=table.contact and bool(place.meshes))  # on a floor
    return at_dusk(place) if table.light == "dusk" else place


def build_props(
    tables: Sequence[ThingTable], performance: Performance, scene: str
) -> list[AnimatedActor]:
    """Make the props of a performance. Raises SceneError with the name of the scene."""
    from egocap_sim.props.registry import make_prop

    props: list[AnimatedActor] = []
    for i, table in enumerate(tables):
        with errors_name_key(scene, f"things.{i}"):
            made = make_prop(table, performance, make_rng(performance.seed, f"thing {i}"))
        props += [
            replace(p, actor=replace(p.actor, name=f"thing-{i + 1} {p.actor.name}")) for p in made
        ]
    return props
