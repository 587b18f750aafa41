"""Simulated motions with their truth, projected into a rig but not rendered.

Rendering dominates the cost of a sequence; studies that draw detections from the truth skip it.
Occlusion is drawn as well: in random bursts, as often as in rendered sequences. Such studies
compare trackers, rigs and faults; absolute errors come from rendered sequences.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.labels import LABELS
from egocap.body.proportions import Proportions
from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.data.truth import SELF_OCCLUDED, VISIBLE, Truth
from egocap.detect.synthetic import ProjectedJoints, simulate_detections
from egocap_sim.scene.config import MotionTable, PlaceTable, RigTable, Scene

HIDDEN_SHARE: Mapping[str, float] = {
    "head": 0.9, "neck": 0.9, "shoulder": 0.15, "elbow": 0.1, "wrist": 0.1, "hand": 0.1,
    "hip": 0.4, "knee": 0.2, "ankle": 0.35, "foot": 0.3,
}  # fmt: skip
"""Share of the time a view misses a joint that its lens sees, rounded from rendered sequences."""
BURST_S = 0.4  # mean length of a stretch in which a joint is hidden


@dataclass(frozen=True, eq=False)
class SimulatedMotion:
    """A motion on a rig: the tracker's inputs, and the truth."""

    name: str
    rig: Rig
    proportions: Proportions
    height_m: float
    truth: Truth
    joint_error_cm: float  # of the physics, to its reference
    planted_foot_speed_cm_s: float

    @property
    def seen(self) -> Bool[Array, "T V 18"]:
        """Joints that a view sees."""
        return self.truth.visibility == VISIBLE


def simulate_motion(
    motion: str,
    *,
    frames: int,
    seed: int,
    rig: str | Rig = "egorig1",
    size: tuple[int, int] = (640, 512),
    fps: float = 30.0,
    parameters: Mapping[str, float] | None = None,
) -> SimulatedMotion:
    """Simulate a built-in motion of a person drawn from `seed`, seen by a rig, without pictures.

    `rig`: the name of a built-in one, or a rig as it is. Raises SceneError for an
    unknown motion, InputError for an unknown rig.
    """
    table = RigTable(name=rig if isinstance(rig, str) else "egorig1", size=size)
    scene = Scene(
        name=motion, frames=frames, fps=fps, seed=seed, rig=table,
        motion=MotionTable(name=motion, parameters=dict(parameters or {})),
        place=PlaceTable(name="room", clear_radius=2.5),
    )  # fmt: skip
    return simulate_scene(scene, None if isinstance(rig, str) else rig.resized(*size))


def simulate_scene(scene: Scene, rig: Rig | None = None) -> SimulatedMotion:
    """Simulate the motion of a scene, seen by its rig or another, without pictures.

    Raises SceneError, or FileError for a motion file that cannot be read.
    """
    from egocap_sim.truth.proportions import measure_proportions
    from egocap_sim.truth.truth import truth_before_rendering
    from egocap_sim.world.world import World

    world = World(scene)
    person, trajectory = world.person, world.trajectory
    made = rig or world.rig
    simulated = SimulatedMotion(
        name=scene.name,
        rig=made,
        proportions=measure_proportions(person),
        height_m=person.height_m,
        truth=truth_before_rendering(person, trajectory, made),
        joint_error_cm=trajectory.stats.joint_error_cm,
        planted_foot_speed_cm_s=trajectory.stats.planted_foot_speed_cm_s,
    )
    return with_bursts(simulated, np.random.default_rng([scene.seed, 1]))


def on_rig(motion: SimulatedMotion, rig: Rig) -> SimulatedMotion:
    """The same motion seen by another rig; joints hidden in a view stay hidden where in view."""
    truth = motion.truth
    pixels, in_view = rig.project(truth.joints_head)
    in_view = np.moveaxis(in_view, 0, 1)
    hidden = truth.visibility == SELF_OCCLUDED
    visibility = np.where(in_view, np.where(hidden, SELF_OCCLUDED, VISIBLE), 1).astype(np.uint8)
    moved = replace(truth, joints_2d=np.moveaxis(pixels, 0, 1), in_view=in_view,
                    visibility=visibility)  # fmt: skip
    return replace(motion, rig=rig, truth=moved)


def with_bursts(motion: SimulatedMotion, rng: np.random.Generator) -> SimulatedMotion:
    """The same motion with joints hidden in bursts, each view and joint by itself."""
    truth = motion.truth
    frame_s = float(np.median(np.diff(truth.time))) if len(truth.time) > 1 else 1.0
    share = np.array([HIDDEN_SHARE[label.rpartition("_")[2]] for label in LABELS])
    hidden = _bursts(truth.in_view.shape, share, frame_s / BURST_S, rng)
    visibility = np.where(truth.in_view & hidden, SELF_OCCLUDED, truth.visibility)
    return replace(motion, truth=replace(truth, visibility=visibility.astype(np.uint8)))


def draw_detections(motion: SimulatedMotion, source: str, seed: int) -> Detections:
    """Simulated detections of a motion by the name of their source (`egocap.detect.synthetic`)."""
    truth = motion.truth
    sizes = np.array([(camera.width, camera.height) for camera in motion.rig.cameras])
    joints = ProjectedJoints(truth.joints_2d, motion.seen, truth.in_view, truth.time, sizes)
    return simulate_detections(joints, source, np.random.default_rng(seed))


def _bursts(
    shape: tuple[int, ...], share: Float[Array, "J"], end: float, rng: np.random.Generator
) -> Bool[Array, "T V J"]:
    """Two-state Markov chain per view and joint: hidden for `share` of the time, left with
    probability `end`."""
    begin = end * share / (1.0 - share)
    draw = rng.random(shape)
    hidden = np.zeros(shape, bool)
    hidden[0] = draw[0] < share
    for t in range(1, shape[0]):
        hidden[t] = np.where(hidden[t - 1], draw[t] >= end, draw[t] < begin)
    return hidden
