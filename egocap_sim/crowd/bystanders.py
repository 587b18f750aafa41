"""Bystanders: their appearance, motions and places, free of collisions.

Their motions are played back without forces. They are placed one after the other; a placement is
accepted if at every checked time all limbs keep clear of the wearer, the things in the scene and
the other bystanders.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.errors import InputError
from egocap.geometry import UP, axis_angle, rigid
from egocap_sim.assets.mesh import AnimatedActor
from egocap_sim.assets.mesh_simplify import simplify
from egocap_sim.core.bodies import INDEX
from egocap_sim.crowd.handshaking import (
    Handshake,
    find_handshake,
    handshake_clip,
    partner_pose,
    reach_palm,
)
from egocap_sim.crowd.obstacles import distance_to_boxes, thing_boxes
from egocap_sim.crowd.wandering import free_courses
from egocap_sim.human.body.limb_distances import RIGHT_ARM, apart, limb_points
from egocap_sim.human.body.person import Person
from egocap_sim.human.clothing.wardrobe import make_person
from egocap_sim.motion.clips.editing import concatenate
from egocap_sim.motion.generators.course import straight_course
from egocap_sim.motion.generators.cycling import leg_scale
from egocap_sim.motion.generators.gestures import GESTURES
from egocap_sim.motion.generators.registry import make_motion
from egocap_sim.motion.generators.stance import draw_style
from egocap_sim.motion.generators.walk import WalkParams, walk_along
from egocap_sim.motion.kinematics.clip import Clip
from egocap_sim.motion.kinematics.posing import pose_figure
from egocap_sim.motion.retarget.retarget import retarget, sample_reference
from egocap_sim.scene.config import OthersTable
from egocap_sim.truth.truth import label_positions

CELL_M = 0.025  # grid cell of the simplified meshes
GAP_M = 0.25  # least distance between points inside two people's limbs
CAMERA_GAP_M = 0.38  # least distance of such points from the cameras; a chest has a 0.2 m radius
THING_GAP_M = 0.15  # least distance of such points from the boxes around things
TRIES = 60  # placements tried before the distance limit is relaxed
_RATE = 60.0  # frames per second of generated motions
_CHECK_S = 0.1  # time step of the distance checks


Rng = np.random.Generator
Bodies = Float[Array, "T 21 4 4"]


def make_bystanders(
    table: OthersTable,
    rng: Rng,
    times: Float[Array, "T"],
    wearer: Bodies,
    bounds_m: float,
    cameras: Float[Array, "T V 3"],
    person: Person | None = None,
    things: Sequence[AnimatedActor] = (),
) -> list[AnimatedActor]:
    """The bystanders of a scene, posed at the frame times [s].

    They keep clear of the `cameras`, which extend beyond the wearer's head, and of `things`, and
    stay within `bounds_m` of the origin. `person` is the wearer, needed for handshakes. Raises
    InputError when there is no room for all of them.
    """
    handshake = None if person is None else find_handshake(person, wearer)
    crowd = _Crowd(table, rng, times, wearer, bounds_m, cameras, things, handshake)
    return [crowd.add(i) for i in range(table.count)]


class _Crowd:
    """The people placed so far, and the search for the next placement."""

    def __init__(
        self,
        table: OthersTable,
        rng: Rng,
        times: Float[Array, "T"],
        wearer: Bodies,
        bounds_m: float,
        cameras: Float[Array, "T V 3"],
        things: Sequence[AnimatedActor],
        handshake: Handshake | None,
    ) -> None:
        self.table, self.rng, self.times, self.bounds_m = table, rng, times, bounds_m
        self.handshake = handshake
        step = max(1, round(_CHECK_S * (len(times) - 1) / max(times[-1] - times[0], 1e-9)))
        self.checked = np.arange(0, len(times), step)
        self.cameras = cameras[self.checked]
        self.boxes = thing_boxes(things, self.checked)
        self.wearer_xy = wearer[:, 0, :2, 3]
        self.limbs = [limb_points(wearer[self.checked])]
        self.pelvises = [self.wearer_xy]

    def add(self, i: int) -> AnimatedActor:
        """Place the next person; without room for the behaviour, gesture or stand instead."""
        name = f"other-{i + 1}"
        person = make_person(int(self.rng.integers(2**31)), bystander=True, name=name)
        behaviour = self.table.behaviours[i % len(self.table.behaviours)]
        bodies = None
        for act in dict.fromkeys((behaviour, "gesture", "stand")):
            bodies = BEHAVIOURS[act](self, person)
            if bodies is not None:
                break
        if bodies is None:
            raise InputError(
                f"no room for person {i + 1} of {self.table.count} beside the wearer",
                valid="fewer [others], a larger farthest_m or a larger [place] clear_radius",
            )
        self.limbs.append(limb_points(bodies[self.checked]))
        self.pelvises.append(bodies[:, 0, :2, 3])
        meshes = tuple(simplify(mesh, CELL_M) for mesh in person.actor.meshes)
        actor = replace(person.actor, meshes=meshes)
        skinning = bodies @ rigid(np.eye(3), -person.joints)
        return AnimatedActor(actor, skinning, label_positions(person, bodies))

    def is_free(self, bodies: Bodies, greets: bool = False) -> bool:
        """Whether a motion stays in bounds and keeps clear of everyone and everything.

        With `greets`, the right arms of the bystander and the wearer may touch.
        """
        limbs = limb_points(bodies[self.checked])
        if np.linalg.norm(limbs[..., :2], axis=-1).max() > self.bounds_m:
            return False
        if np.linalg.norm(limbs[:, :, None] - self.cameras[:, None], axis=-1).min() < CAMERA_GAP_M:
            return False
        if distance_to_boxes(limbs, self.boxes) < THING_GAP_M:
            return False
        wearer, *others = self.limbs
        ignored = RIGHT_ARM if greets else ()
        mine, theirs = (np.delete(points, ignored, axis=1) for points in (limbs, wearer))
        return bool(apart(mine, theirs, GAP_M).all()) and all(
            apart(limbs, other, GAP_M).all() for other in others
        )

    def place(self, local: Bodies, arrival: int = 0) -> Bodies | None:
        """Place a motion near the wearer, facing it in frame `arrival`; None without room.

        `local` starts at the origin. Nearer placements are likelier; after `TRIES` attempts the
        distance may exceed `farthest_m`.
        """
        at, facing = local[arrival, 0, :2, 3], local[arrival, INDEX["chest"], :2, 0]
        heading = np.arctan2(facing[1], facing[0])
        near, farthest = self.table.nearest_m, self.table.farthest_m
        for attempt in range(3 * TRIES):
            stretch = max(0.0, attempt / TRIES - 1.0) / 2.0
            far = farthest + stretch * max(0.0, self.bounds_m - farthest)
            centre = self.wearer_xy[int(self.rng.integers(len(self.wearer_xy)))]
            # Mostly on the side that the wearer faces at the start.
            angle = float(np.clip(self.rng.normal(0.0, 1.1), -np.pi, np.pi))
            around = np.array([np.cos(angle), np.sin(angle)])
            spot = centre + self.rng.uniform() ** 1.5 * (far - near) * around + near * around
            towards = self.wearer_xy[arrival] - spot
            yaw = np.arctan2(towards[1], towards[0]) - heading + self.rng.normal(0.0, 0.25)
            R = axis_angle(UP, float(yaw))
            there = rigid(R, np.array([*spot, 0.0]) - R @ np.array([*at, 0.0])) @ local
            if self.is_free(there):
                return there
        return None

    @property
    def seconds(self) -> float:
        return max(float(self.times[-1] - self.times[0]), 0.5)

    def played(self, clip: Clip, person: Person, from_origin: bool = True) -> Bodies:
        return sample_reference(
            person, retarget(clip, person, from_origin=from_origin), self.times - self.times[0]
        )


def _stand(crowd: _Crowd, person: Person) -> Bodies | None:
    """Stand and look around."""
    motion = ("idle", "look_around")[int(crowd.rng.integers(2))]
    clip = make_motion(motion, crowd.seconds + 0.5, crowd.rng)
    return crowd.place(crowd.played(clip, person))


def _gesture(crowd: _Crowd, person: Person) -> Bodies | None:
    """Stand and talk to the wearer with the hands."""
    kinds = ("explain", "wave", "point", "hands_together", "touch_head")
    assert set(kinds) <= GESTURES.keys()
    clip = make_motion("gestures", crowd.seconds + 0.5, crowd.rng, kinds=kinds)
    return crowd.place(crowd.played(clip, person))


def _approach(crowd: _Crowd, person: Person) -> Bodies | None:
    """Walk up to the wearer and talk."""
    rng, speed = crowd.rng, float(crowd.rng.uniform(0.8, 1.2))
    length = float(min(rng.uniform(0.8, 2.5), max(0.5, 0.5 * speed * crowd.seconds)))
    scale = leg_scale(person)
    course, seconds = straight_course(length / scale, speed / scale)
    t = np.arange(round(seconds * _RATE) + 1) / _RATE
    params = WalkParams(speed=speed / scale)
    steps = pose_figure("walk", _RATE, walk_along(course, t, rng, params, draw_style(rng)))
    talk = make_motion("gestures", max(crowd.seconds - seconds, 0.0) + 1.0, rng)
    local = crowd.played(concatenate("approach", [steps, talk]), person)
    return crowd.place(
        local, arrival=int(np.searchsorted(crowd.times - crowd.times[0], seconds) - 1)
    )


def _walk_by(crowd: _Crowd, person: Person) -> Bodies | None:
    """Walk around and past the wearer, avoiding everyone."""
    rng, speed = crowd.rng, float(crowd.rng.uniform(0.8, 1.3))
    scale = leg_scale(person)
    params = WalkParams(speed=speed / scale)
    bounds_m, near_m = crowd.bounds_m - 0.35, crowd.table.farthest_m
    for course in free_courses(rng, crowd.times, crowd.pelvises, speed, bounds_m, near_m, scale):
        t = np.arange(round((crowd.seconds + 0.2) * _RATE) + 1) / _RATE
        steps = pose_figure("walk", _RATE, walk_along(course, t, rng, params, draw_style(rng)))
        bodies = crowd.played(steps, person, from_origin=False)
        if crowd.is_free(bodies):
            return bodies
    return None


def _shake_hands(crowd: _Crowd, person: Person) -> Bodies | None:
    """Stand opposite the wearer and shake the extended hand."""
    if crowd.handshake is None:
        return None
    clip = handshake_clip(crowd.handshake, crowd.times, crowd.rng, _RATE)
    there = partner_pose(crowd.handshake, person) @ crowd.played(clip, person)
    fps = (len(crowd.times) - 1) / crowd.seconds
    bodies = reach_palm(crowd.handshake, person, there, fps)
    return bodies if crowd.is_free(bodies, greets=True) else None


BEHAVIOURS: dict[str, Callable[[_Crowd, Person], Bodies | None]] = {
    "walk_by": _walk_by, "stand": _stand, "gesture": _gesture, "approach": _approach,
    "shake_hands": _shake_hands,
}  # fmt: skip
