"""From a scene to who acts in it: the wearer, the rig, and the motion played under physics.

Each part draws from its own random stream, named by what it is for, so that changing one of them
leaves the others as they were.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from egocap.cameras.rig import Rig
from egocap.cameras.rig_files import load_rig
from egocap.errors import FileError, InputError
from egocap_sim.core.resources import SAMPLED, rig_file
from egocap_sim.core.rng import stream
from egocap_sim.scene.config import MotionTable, PersonTable, RigTable, Scene
from egocap_sim.scene.rig_sampler import headgear_for, sample_rig

if TYPE_CHECKING:
    from egocap_sim.core.pose_sampling import SampledPoses
    from egocap_sim.core.trajectory import Trajectory
    from egocap_sim.human.body.person import Person
    from egocap_sim.motion.kinematics.clip import Clip
    from egocap_sim.motion.retarget.retarget import Reference
    from egocap_sim.sensor.config import SensorTable

DEFAULT_RIG = "egorig1"
_RIG_HEADGEAR = {"egorig1": "helmet", "egorig2": "headset"}  # what a built-in rig is worn on


_RESAMPLING_S = 0.02  # retargeting may lose as much of a clip's end
_LEAD_S = 0.5  # of an episode's motion before its first frame: for smoothing and standing feet
_MOTION_S = 30.0
"""Procedural motions are made in multiples of this, so that fewer frames are the start of more."""


class SceneError(InputError):
    """A table of a scene, `key`, asks for something that cannot be made."""

    def __init__(self, scene: Scene, key: str, problem: str) -> None:
        super().__init__(f"scene '{scene.name}', key '{key}': {problem}")
        self.key, self.problem = key, problem


@contextmanager
def table_of(scene: Scene, key: str) -> Iterator[None]:
    """Put what is wrong on a table of the scene; errors that name a file say enough."""
    try:
        yield
    except InputError as error:
        raise SceneError(scene, key, str(error)) from None


def rig_of(table: RigTable, seed: int | None = None) -> Rig:
    """The scene's rig at the recorded image size; a sampled one needs the scene's seed."""
    if table.name == SAMPLED:
        assert seed is not None
        return _sampled_rig(seed, table.size)
    rig = load_rig(Path(table.file) if table.file else rig_file(table.name or DEFAULT_RIG))
    return rig.resized(*table.size) if table.size else rig


@lru_cache(maxsize=4)
def _sampled_rig(seed: int, size: tuple[int, int] | None) -> Rig:
    rig = sample_rig(stream(seed, "rig"))
    return rig.resized(*size) if size else rig


def sensor_of(scene: Scene) -> SensorTable | None:
    """The scene's sensor; None for a perfect one."""
    return scene.sensor if scene.sensor is not None and scene.sensor.active else None


def calibrated_rig_of(scene: Scene) -> Rig:
    """The rig as trackers know it: the scene's, off by its sensor's calibration error."""
    from egocap_sim.sensor.faults import miscalibrate

    rig, sensor = rig_of(scene.rig, scene.seed), sensor_of(scene)
    if sensor is None or not sensor.miscalibrated:
        return rig
    return miscalibrate(rig, sensor, stream(scene.seed, "sensor.calibration"))


def person_of(scene: Scene) -> Person:
    """The wearer: what the scene says, the rest drawn from the seed."""
    from egocap_sim.human.clothing.wardrobe import make_person

    table: PersonTable = scene.person
    headgear = table.headgear
    if headgear == "rig":
        rig = rig_of(scene.rig, scene.seed)
        if scene.rig.name == SAMPLED:
            headgear = headgear_for(rig, stream(scene.seed, "headgear"))
        else:
            headgear = _RIG_HEADGEAR.get(rig.name, "helmet")
    asked = table.model_dump(exclude={"headgear"}, exclude_none=True)
    worn = None if headgear == "none" else headgear
    with table_of(scene, "person"):
        return make_person(scene.seed, headgear=worn, name="wearer", **asked)


def clip_of(scene: Scene) -> Clip:
    """The reference motion, made or read."""
    motion: MotionTable = scene.motion
    if motion.file is not None:
        from egocap_sim.motion.clips.clip_store import stored_clip

        names = Path(motion.joint_names) if motion.joint_names else None
        clip = stored_clip(Path(motion.file), up=motion.up, unit=motion.unit, names=names)
        return _variant(motion, clip)
    from egocap_sim.motion.clips.variants import shortened
    from egocap_sim.motion.generators.registry import make_motion

    assert motion.name is not None
    needed = motion.start_s + (scene.frames + 1) / scene.fps
    duration = motion.length_s or math.ceil(needed / _MOTION_S) * _MOTION_S
    rng = stream(scene.seed, "motion")
    clip = make_motion(motion.name, duration, rng, **motion.parameters)
    if skipped := _skipped_s(motion):
        clip = shortened(clip, skipped, duration)
    return clip


def _skipped_s(motion: MotionTable) -> float:
    """How much of the start of an episode's own motion nobody needs to play."""
    from egocap_sim.motion.generators.registry import MOTIONS

    if motion.name is None or motion.length_s is None or MOTIONS[motion.name].mounted:
        return 0.0
    return max(0.0, motion.start_s - _LEAD_S)


def _variant(motion: MotionTable, clip: Clip) -> Clip:
    """What the scene makes of a clip."""
    from egocap_sim.motion.clips.clip_store import stored_clip
    from egocap_sim.motion.clips.variants import hurried, joined, mirrored, shortened

    if motion.then is not None:
        assert motion.length_s is not None
        half = 0.5 * motion.length_s * motion.speed
        other = shortened(stored_clip(Path(motion.then)), motion.then_start_s, half)
        clip = joined(shortened(clip, motion.start_s, half), other)
    elif motion.length_s is not None:
        clip = shortened(clip, motion.start_s, motion.length_s * motion.speed)
    if motion.mirrored:
        clip = mirrored(clip)
    return hurried(clip, motion.speed) if motion.speed != 1.0 else clip


def _start_s(motion: MotionTable) -> float:
    """Where in the clip made of the scene's motion the recording begins."""
    if motion.file is not None and motion.length_s is not None:
        return 0.0
    return motion.start_s - _skipped_s(motion)


def frames_of_clip(scene: Scene) -> int:
    """How many frames the scene's motion file lasts from where the scene starts it."""
    with table_of(scene, "motion"):
        return _frames_in(clip_of(scene), scene)


def _frames_in(clip: Clip, scene: Scene) -> int:
    start = _start_s(scene.motion)
    seconds = (len(clip.positions) - 1) / clip.fps - start - _RESAMPLING_S
    if seconds <= 0:
        raise InputError(
            f"start_s = {start:g} is beyond the end of {clip.name}",
            valid=f"less than {seconds + start:.2f} s",
        )
    return int(seconds * scene.fps) + 1


def reference_of(scene: Scene, clip: Clip, person: Person) -> Reference:
    """A clip on the person's own bones, brought to the floor or to what carries the person."""
    from egocap_sim.motion.generators.registry import MOTIONS, motion_parameters
    from egocap_sim.motion.retarget.retarget import retarget

    motion = scene.motion
    mounted = MOTIONS[motion.name].mounted if motion.name in MOTIONS else None
    if motion.name is None or mounted is None:
        return retarget(clip, person, from_origin=not _skipped_s(motion))
    reference = retarget(clip, person, from_origin=False, grounded=False)
    parameters = motion_parameters(motion.name, motion.parameters)
    return mounted(reference, person, stream(scene.seed, "motion"), parameters)


def perform(scene: Scene, person: Person) -> Trajectory:
    """Retarget the motion to the person and play it under physics, at the cameras' frame rate."""
    return _simulated(scene, person, 1, scene.frames)


def perform_finely(scene: Scene, person: Person) -> tuple[Trajectory, SampledPoses]:
    """`perform`, and the same motion at every step of the physics, to beyond the last frame.

    The cameras' steps are the same ones, so the trajectory is the same to the bit.
    """
    from egocap_sim.core.pose_sampling import SampledPoses
    from egocap_sim.physics.simulation import steps_per_frame

    assert scene.sensor is not None
    steps = steps_per_frame(scene.fps)
    late = max(scene.sensor.time_offset_s, 0) + scene.sensor.shutter_s + scene.sensor.readout_s
    frames = scene.frames + math.ceil(late * scene.fps)
    fine = _simulated(scene, person, steps, (frames - 1) * steps + 1)
    rows = slice(0, (scene.frames - 1) * steps + 1, steps)
    trajectory = replace(
        fine,
        fps=scene.fps,
        T_world_body=fine.T_world_body[rows],
        contact=fine.contact[rows],
        ground_force=fine.ground_force[rows],
        root_wrench=fine.root_wrench[rows],
    )
    return trajectory, SampledPoses.of(fine.T_world_body, fine.fps)


def _simulated(scene: Scene, person: Person, per_frame: int, samples: int) -> Trajectory:
    from egocap_sim.physics.simulation import simulate

    with table_of(scene, "motion"):
        clip = clip_of(scene)
        if scene.motion.file and scene.frames > (most := _frames_in(clip, scene)):
            raise InputError(
                f"{scene.frames} frames are more than the clip has", valid=f"1 to {most}"
            )
        return simulate(
            person,
            reference_of(scene, clip, person),
            fps=scene.fps * per_frame,
            n_frames=samples,
            start_s=_start_s(scene.motion),
            force_every=per_frame,
        )


def config_of(scene: Scene) -> dict[str, Any]:
    """All that the content of the sequence depends on, resolved, for the manifest and its hash.

    Files are named by their checksum, not by where they lie.
    """
    config = scene.model_dump(mode="json", exclude_none=True)
    for table, key, value in (
        ("motion", "mirrored", False), ("motion", "speed", 1.0), ("motion", "then_start_s", 0.0),
        ("sensor", "subframe_sharpness", 1.0),
    ):  # fmt: skip
        if config.get(table, {}).get(key) == value:  # older versions knew none of them
            del config[table][key]
    config["rig"] = rig_of(scene.rig, scene.seed).to_dict()
    for key in ("file", "joint_names", "then"):
        if path := config["motion"].pop(key, None):
            config["motion"][key] = {"name": Path(path).name, "sha256": _checksum(Path(path))}
    if file := config["place"].pop("panorama", None):
        config["place"]["panorama"] = {"name": Path(file).name, "sha256": _checksum(Path(file))}
    if folder := config["place"].pop("textures", None):
        from egocap_sim.environment.texture_folder import picture_files

        config["place"]["textures"] = {p.name: _checksum(p) for p in picture_files(Path(folder))}
    return config


def _checksum(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror}") from None
