"""Camera housings on the wearer's head, and the arms that join them to the headgear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.cameras.rig import Mount, Rig
from egocap.geometry import transform
from egocap_sim.assets.mesh import Mesh
from egocap_sim.assets.primitives import box, tube
from egocap_sim.assets.textures import even
from egocap_sim.core.bodies import INDEX
from egocap_sim.core.part_labels import RIG
from egocap_sim.human.body.person import Person

ANCHORS: dict[str, tuple[float, float, float]] = {
    "helmet": (0.125, 0.070, 0.145), "headset": (0.150, 0.080, 0.055),
    "cap": (0.135, 0.050, 0.110), "glasses": (0.118, 0.062, 0.045),
}  # fmt: skip
"""Where arms start on each headgear: forward and up, and the largest distance to the left [m]."""
_SIDE_M = {"helmet": 0.026, "headset": 0.014, "cap": 0.020, "glasses": 0.008}  # of a housing
_RADIUS_M = {"helmet": 0.006, "headset": 0.004, "cap": 0.004, "glasses": 0.0015}  # of an arm
_GAP_M = 0.004  # between the centre of projection and the housing behind it
_SHORTEST_M = 0.01  # an arm
_DARK = replace(even((0.035, 0.035, 0.04)), part=RIG, shininess=0.3)


def with_cameras(person: Person, rig: Rig, headgear: str | None) -> Person:
    """The person with the rig's housings and arms; without headgear there are none.

    A housing lies behind its camera, outside the camera's own field of view.
    """
    if headgear is None:
        return person
    head = person.joints[INDEX["head"]]
    made = [mesh for mount in rig.mounts for mesh in _mounted(mount, headgear)]
    worn = (_on_head(mesh, head) for mesh in made)
    return replace(person, actor=replace(person.actor, meshes=(*person.actor.meshes, *worn)))


def _mounted(mount: Mount, headgear: str) -> list[Mesh]:
    """Housing and arm of one camera in the head frame."""
    T, side = mount.T_head_camera, _SIDE_M[headgear]
    beyond = max(0.0, mount.camera.max_angle - np.pi / 2)  # of the half space ahead
    behind = _GAP_M + side / np.sqrt(2.0) * np.tan(min(beyond, 1.2)) + side / 2
    centre = np.array([0.0, 0.0, -behind])
    housing = box(f"camera {mount.name}", centre, (side, side, side), _DARK)
    housing = replace(housing, vertices=transform(T, housing.vertices))
    end = transform(T, centre[None])[0]
    forward, farthest, up = ANCHORS[headgear]
    start = np.array([forward, np.clip(end[1], -farthest, farthest), up])
    if np.linalg.norm(end - start) < _SHORTEST_M:
        return [housing]
    return [housing, tube(f"arm {mount.name}", start, end, _RADIUS_M[headgear], _DARK)]


def _on_head(mesh: Mesh, head: Float[Array, "3"]) -> Mesh:
    """A mesh of the head frame at rest in the world, moving with the head."""
    bones = np.zeros((len(mesh.vertices), 4), np.int32)
    bones[:, 0] = INDEX["head"]
    weights = np.tile([1.0, 0.0, 0.0, 0.0], (len(mesh.vertices), 1))
    return replace(mesh, vertices=mesh.vertices + head, bones=bones, weights=weights)
