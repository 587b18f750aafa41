"""The setting of a scene: the place, the things in it and the other people, around the wearer."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.core.rng import stream
from egocap_sim.scene.config import Scene
from egocap_sim.world.stage import SceneError, person_of, rig_of, table_of

if TYPE_CHECKING:
    from egocap.data.sequence import Truth
    from egocap_sim.assets.mesh import AnimatedActor
    from egocap_sim.environment.place import Place

_ELBOW_ROOM_M = 0.3  # between the outermost joint of a recorded motion and furniture


def check_place(scene: Scene) -> None:
    """Raise SceneError unless there is such a place, FileError for a broken picture of a user's.

    Making the place, which workers do, takes longer.
    """
    from egocap_sim.environment.places import PLACES

    if scene.place.name not in PLACES:
        problem = f"unknown place '{scene.place.name}' (valid: {', '.join(PLACES)})"
        raise SceneError(scene, "place.name", problem)
    if scene.place.textures is not None:
        from egocap_sim.environment.texture_folder import picture_files, read_picture

        for path in picture_files(Path(scene.place.textures)):
            read_picture(path)
    if scene.place.panorama is not None:
        from egocap_sim.environment.panorama import read_panorama

        read_panorama(Path(scene.place.panorama))


def check_things(scene: Scene) -> None:
    """Raise SceneError unless every thing is known and goes with the motion."""
    if scene.things:
        from egocap_sim.props.registry import check_prop

        for i, thing in enumerate(scene.things):
            with table_of(scene, f"things.{i}"):
                check_prop(thing, scene.motion.name)


def clear_radius_of(scene: Scene, truth: Truth) -> float:
    """Metres kept free around the origin: the scene's, or as far as a motion file goes."""
    from egocap_sim.environment.places import LARGEST_RADIUS_M

    if scene.motion.file is None:
        return scene.place.clear_radius
    reach = float(np.linalg.norm(truth.T_world_body[..., :2, 3], axis=-1).max()) + _ELBOW_ROOM_M
    return max(scene.place.clear_radius, min(reach, LARGEST_RADIUS_M))


def place_of(scene: Scene, truth: Truth) -> Place:
    """The surroundings, large enough for the wearer's way."""
    from egocap_sim.environment.place import at_dusk
    from egocap_sim.environment.places import make_place
    from egocap_sim.environment.texture_folder import picture_files, with_pictures

    table = scene.place
    radius = clear_radius_of(scene, truth)
    place = make_place(table.name, stream(scene.seed, "place"), clear_radius=radius)
    if table.textures is not None:
        files = picture_files(Path(table.textures))
        place = with_pictures(place, files, stream(scene.seed, "textures"))
    if table.panorama is not None:
        from egocap_sim.environment.panorama import read_panorama, with_panorama

        place = with_panorama(place, read_panorama(Path(table.panorama)))
    place = replace(place, contact=table.contact and bool(place.meshes))  # on a floor
    return at_dusk(place) if table.light == "dusk" else place


def extras_of(scene: Scene, truth: Truth) -> list[AnimatedActor]:
    """Everything else that moves, at the frame times of `truth`: the same in every process."""
    extras = [extra for i in range(len(scene.things)) for extra in _thing(scene, i, truth)]
    if scene.others.count:
        from egocap_sim.crowd.bystanders import make_bystanders

        with table_of(scene, "others"):
            extras += make_bystanders(
                scene.others,
                stream(scene.seed, "others"),
                truth.time,
                truth.T_world_body,
                clear_radius_of(scene, truth),
                truth.T_world_head[:, None, :3, 3] + _camera_arms(scene, truth),
                person=person_of(scene) if "shake_hands" in scene.others.behaviours else None,
            )
    return extras


def _camera_arms(scene: Scene, truth: Truth) -> Float[Array, "T V 3"]:
    """From the head to the cameras, world axes."""
    arms = np.stack([m.T_head_camera[:3, 3] for m in rig_of(scene.rig, scene.seed).mounts])
    return arms @ np.swapaxes(truth.T_world_head[:, :3, :3], -1, -2)


def _thing(scene: Scene, index: int, truth: Truth) -> list[AnimatedActor]:
    from egocap_sim.props.performance import Performance
    from egocap_sim.props.registry import make_prop

    times = truth.time - truth.time[0]
    performance = Performance(person_of(scene), scene.motion, scene.seed, times, truth.T_world_body)
    rng = stream(scene.seed, f"thing {index}")
    with table_of(scene, f"things.{index}"):
        extras = make_prop(scene.things[index], performance, rng)
    return [
        replace(e, actor=replace(e.actor, name=f"thing-{index + 1} {e.actor.name}")) for e in extras
    ]
