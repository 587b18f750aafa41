"""The simulated world of a scene: rig, wearer, motion, place, props and bystanders."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.cameras.rig import Rig
from egocap.geometry import rigid
from egocap_sim.core.bodies import INDEX
from egocap_sim.core.rng import make_rng
from egocap_sim.scene.config import Scene
from egocap_sim.scene.rig_source import resolve_headgear, resolve_rig
from egocap_sim.scene.scene_error import errors_name_key
from egocap_sim.world.motion_source import MotionSource
from egocap_sim.world.resolved_config import resolve_config
from egocap_sim.world.surroundings import build_place, build_props, check_place, radius_around
from egocap_sim.world.take import Take

if TYPE_CHECKING:
    from egocap_sim.assets.mesh import AnimatedActor
    from egocap_sim.core.pose_sampling import SampledPoses
    from egocap_sim.core.trajectory import Trajectory
    from egocap_sim.environment.place import Place
    from egocap_sim.human.body.person import Person
    from egocap_sim.sensor.config import SensorTable


class World:
    """The parts of a scene. Each is made once, when it is first used.

    Every part has its own random generator, so that a change of one part does not affect the
    others. A part that cannot be made raises SceneError or FileError.
    """

    def __init__(self, scene: Scene, take: Take | None = None) -> None:
        """`take`: an already simulated take; None: simulated when it is first used."""
        self.scene = scene
        self._given_take = take

    @cached_property
    def config(self) -> dict[str, Any]:
        """All that the content of the sequence depends on, for the manifest and its hash."""
        return resolve_config(self.scene, self.rig)

    @cached_property
    def rig(self) -> Rig:
        """The true rig, at the recorded image size."""
        return resolve_rig(self.scene.rig, self.scene.seed)

    @cached_property
    def calibrated_rig(self) -> Rig:
        """The rig for trackers, with the calibration error of the sensor."""
        from egocap_sim.sensor.faults import miscalibrate

        if self.sensor is None or not self.sensor.miscalibrated:
            return self.rig
        return miscalibrate(self.rig, self.sensor, make_rng(self.scene.seed, "sensor.calibration"))

    @property
    def sensor(self) -> SensorTable | None:
        """The sensor; None for a perfect one."""
        sensor = self.scene.sensor
        return sensor if sensor is not None and sensor.active else None

    @cached_property
    def person(self) -> Person:
        """The wearer; missing values are drawn from the seed."""
        from egocap_sim.human.clothing.camera_mounts import with_cameras
        from egocap_sim.human.clothing.wardrobe import make_person

        table, seed = self.scene.person, self.scene.seed
        headgear = table.headgear
        if headgear == "rig":
            headgear = resolve_headgear(self.scene.rig, self.rig, seed)
        given = table.model_dump(exclude={"headgear"}, exclude_none=True)
        worn = None if headgear == "none" else headgear
        with errors_name_key(self.scene.name, "person"):
            person = make_person(seed, headgear=worn, name="wearer", **given)
        return with_cameras(person, self.rig, worn)

    @cached_property
    def motion(self) -> MotionSource:
        """The reference motion."""
        scene = self.scene
        return MotionSource(scene.motion, scene.fps, scene.frames, scene.seed)

    @cached_property
    def clip_frames(self) -> int:
        """Number of frames from the start time to the end of the reference motion."""
        with errors_name_key(self.scene.name, "motion"):
            return self.motion.available_frames(self.motion.clip())

    @cached_property
    def simulated(self) -> tuple[Trajectory, SampledPoses | None]:
        """The simulated motion at the frames, and between them if the sensor requires it."""
        margins_s, sensor = None, self.sensor
        if sensor is not None and sensor.timed:
            late_s = 1e-6 * sensor.clock_drift_ppm * self.scene.frames / self.scene.fps
            exposure_s = sensor.shutter_s + sensor.readout_s
            margins_s = (
                max(-sensor.time_offset_s, 0) + exposure_s / 2,
                max(sensor.time_offset_s + late_s, 0) + exposure_s,
            )
        with errors_name_key(self.scene.name, "motion"):
            return self.motion.simulate(self.person, margins_s)

    @property
    def trajectory(self) -> Trajectory:
        """The simulated motion at the frame times."""
        return self.simulated[0]

    @cached_property
    def take(self) -> Take:
        """The truth before rendering and the effect of the sensor on each frame."""
        return simulate_take(self) if self._given_take is None else self._given_take

    @cached_property
    def clear_radius(self) -> float:
        """Metres kept free around the origin: the scene's, or as many as the motion needs."""
        bodies = self.take.truth.T_world_body
        with errors_name_key(self.scene.name, "motion"):
            return radius_around(bodies, self.scene.place)

    @cached_property
    def place(self) -> Place:
        """The surroundings."""
        return build_place(self.scene.place, self.scene.seed, self.clear_radius)

    @cached_property
    def actors(self) -> list[AnimatedActor]:
        """Props and bystanders, posed at the frame times, and after them for late exposures."""
        props = self._props()
        return [*props, *self._bystanders(props)]

    def skinning(self, frame: int) -> dict[str, Float[Array, "B 4 4"]]:
        """Skinning transforms of the wearer and all other actors at a frame, by name."""
        T_body_rest = rigid(np.eye(3), -self.person.joints)
        wearer = self.take.truth.T_world_body[frame] @ T_body_rest
        others = {actor.actor.name: actor.skinning[frame] for actor in self.actors}
        return {self.person.actor.name: wearer} | others

    @cached_property
    def _performed(self) -> tuple[Float[Array, "T"], Float[Array, "T 21 4 4"]]:
        """Times and poses of the wearer's bodies for the actors: those of `actors`."""
        truth, plan = self.take.truth, self.take.sensor_plan
        if plan is None or plan.poses is None:
            return truth.time, truth.T_world_body
        last = round(plan.poses.end_s * self.scene.fps)
        later = np.arange(len(truth.time), last + 1) / self.scene.fps
        bodies = np.concatenate([truth.T_world_body, plan.poses.at(later)])
        return np.concatenate([truth.time, later]), bodies

    def _props(self) -> list[AnimatedActor]:
        if not self.scene.things:
            return []
        from egocap_sim.props.performance import Performance

        scene, (times, bodies) = self.scene, self._performed
        performance = Performance(self.person, scene.motion, scene.seed, times, bodies)
        return build_props(scene.things, performance, scene.name)

    def _bystanders(self, props: list[AnimatedActor]) -> list[AnimatedActor]:
        table = self.scene.others
        if not table.count:
            return []
        from egocap_sim.crowd.bystanders import make_bystanders

        times, bodies = self._performed
        T_world_head = bodies[:, INDEX["head"]]
        arms = self.rig.T_head_camera[:, :3, 3] @ np.swapaxes(T_world_head[:, :3, :3], -1, -2)
        with errors_name_key(self.scene.name, "others"):
            return make_bystanders(
                table,
                make_rng(self.scene.seed, "others"),
                times,
                bodies,
                self.clear_radius,
                T_world_head[:, None, :3, 3] + arms,
                person=self.person if "shake_hands" in table.behaviours else None,
                things=props,
            )


def build_world(scene: Scene) -> World:
    """Make the world of a scene. Raises SceneError or FileError for an unknown place or prop."""
    with errors_name_key(scene.name, "place.name"):
        check_place(scene.place)
    if scene.things:
        from egocap_sim.props.registry import check_prop

        for i, thing in enumerate(scene.things):
            with errors_name_key(scene.name, f"things.{i}"):
                for motion in _drawn_motions(scene):
                    check_prop(thing, motion)
    return World(scene)


def _drawn_motions(scene: Scene) -> list[str | None]:
    """The motions that may be played: names of built-in ones, and None for a motion file."""
    table = scene.episodes
    if table is None:
        return [scene.motion.name]
    clips = [None] if table.clips is not None and table.clip_share else []
    return [*(table.motions or (scene.motion.name,)), *clips]


def load_world(scene: Scene, drafts: Path | Mapping[str, bytes]) -> World:
    """Make the world of a scene in a worker process, with the saved take."""
    world = World(scene)
    return World(scene, Take.load(drafts, world.sensor, scene.seed))


def simulate_take(world: World) -> Take:
    """Simulate the motion, derive the truth and plan the sensor."""
    from egocap_sim.sensor.plan import plan_sensor
    from egocap_sim.truth.truth import truth_before_rendering

    trajectory, poses = world.simulated
    truth = truth_before_rendering(world.person, trajectory, world.rig)
    if world.sensor is None:
        return Take(truth, None)
    plan, truth = plan_sensor(truth, world.person, poses, world.rig, world.sensor, world.scene.seed)
    return Take(truth, plan)
