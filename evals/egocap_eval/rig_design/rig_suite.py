"""The motions over which rigs are compared: simulated, not rendered.

Joints are the simulated person's; angles of the tracker's skeleton are fitted to them; the
person's own dressed body occludes joints (`egocap_eval.rig_design.ray_visibility`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.labels import LABELS
from egocap.body.proportions import Proportions
from egocap.cameras.rig import Rig
from egocap.geometry import inverse, transform

if TYPE_CHECKING:
    from egocap_eval.rig_design.ray_visibility import RayVisibility

SUITE = ("walk", "bike", "basketball", "juggler", "vr", "live")
FPS = 30.0
FRAMES_A_MOTION = 50
"""Approximate frames of each motion for the single-frame bound."""
BLOCK_S = 1.0
"""Frames within this time count as one draw."""
_SAME_PLACE_M = 1e-6


@dataclass(frozen=True, eq=False)
class Motion:
    """One motion at the camera's frame rate."""

    name: str
    joints: Float[Array, "T 18 3"]  # true, head frame
    angles: Float[Array, "T 37"]  # of the tracker's skeleton, nearest to them
    proportions: Proportions
    bodies: Float[Array, "T 21 4 4"] | None = None  # T_head_body
    rays: RayVisibility | None = None  # None: no occlusion

    @property
    def times(self) -> Float[Array, "T"]:
        """Seconds."""
        return np.arange(len(self.joints)) / FPS

    @property
    def blocks(self) -> Float[Array, "T"]:
        """Index of the block that each frame belongs to."""
        return np.floor(self.times / BLOCK_S)

    def shown(self, places: Float[Array, "U 3"]) -> Bool[Array, "T U 18"]:
        """Which joints are unoccluded from places in the head frame."""
        if self.rays is None or self.bodies is None:
            return np.ones((len(self.joints), len(places), len(LABELS)), bool)
        return self.rays.shown(self.bodies, places)

    def thinned(self) -> Motion:
        """About FRAMES_A_MOTION of its frames, evenly spread."""
        few = self.every()
        bodies = None if self.bodies is None else self.bodies[few]
        return replace(self, joints=self.joints[few], angles=self.angles[few], bodies=bodies)

    def every(self) -> slice:
        """The frames that `thinned` keeps."""
        return slice(None, None, max(1, len(self.joints) // FRAMES_A_MOTION))


@dataclass(frozen=True, eq=False)
class SuiteVisibility:
    """Visibility of the joints of some motions from the camera places of some rigs."""

    motions: tuple[Motion, ...]
    places: Float[Array, "U 3"]  # head frame, metres
    shown: tuple[Bool[Array, "T U 18"], ...]  # of each motion

    @classmethod
    def of(cls, motions: Sequence[Motion], rigs: Sequence[Rig]) -> SuiteVisibility:
        """Visibility from every camera of every rig, computed once for each place."""
        places = np.unique(np.concatenate([_keys(rig) for rig in rigs]), axis=0) * _SAME_PLACE_M
        return cls(tuple(motions), places, tuple(motion.shown(places) for motion in motions))

    def seen(self, rig: Rig, motion: int) -> Bool[Array, "T V 18"]:
        """Which joints each view of one of the rigs sees: inside lens and image, not hidden."""
        _, in_view = rig.project(self.motions[motion].joints)  # (V, T, 18)
        known = np.round(self.places / _SAME_PLACE_M)
        which = [int(np.flatnonzero((known == key).all(1))[0]) for key in _keys(rig)]
        return np.moveaxis(in_view, 0, 1) & self.shown[motion][:, which]


def _keys(rig: Rig) -> Float[Array, "V 3"]:
    """Camera places in whole steps, so that equal ones are found equal."""
    return np.round(rig.T_head_camera[:, :3, 3] / _SAME_PLACE_M) + 0.0


def load_suite(names: Sequence[str], frames: int) -> list[Motion]:
    """Simulate the motions of built-in scenes, without pictures. Raises FileError."""
    from egocap_eval.harness.footage import builtin_scene
    from egocap_eval.priors.takes import fit_angles
    from egocap_eval.rig_design.ray_visibility import RayVisibility
    from egocap_sim.core.bodies import INDEX
    from egocap_sim.truth.proportions import measure_proportions
    from egocap_sim.truth.truth import label_positions
    from egocap_sim.world.world import World

    motions = []
    for name in names:
        world = World(builtin_scene(name, frames=frames))
        person, T_world_body = world.person, world.trajectory.T_world_body
        T_head_world = inverse(T_world_body[:, INDEX["head"]])
        joints = transform(T_head_world, label_positions(person, T_world_body))
        proportions = measure_proportions(person)
        motions.append(
            Motion(name, joints, fit_angles(joints, proportions), proportions,
                   T_head_world[:, None] @ T_world_body, RayVisibility(person))
        )  # fmt: skip
    return motions
