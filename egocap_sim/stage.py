"""From a scene to everything that stands on the stage: wearer, place, rig and the motion played.

Each part draws from its own random stream, named by what it is for, so that changing one of them
leaves the others as they were.
"""

from __future__ import annotations

import hashlib
import math
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from egocap.errors import FileError, InputError
from egocap.rig import Rig, load_rig
from egocap_sim.builtin import builtin_file
from egocap_sim.scene import MotionTable, PersonTable, RigTable, Scene

if TYPE_CHECKING:
    from egocap.sequence import Truth
    from egocap_sim.extras import Extra
    from egocap_sim.human.person import Person
    from egocap_sim.motion.clip import Clip
    from egocap_sim.place import Place
    from egocap_sim.trajectory import Trajectory

DEFAULT_RIG = "egorig1"
_RIG_HEADGEAR = {"egorig1": "helmet", "egorig2": "headset"}  # what a built-in rig is worn on


_MOTION_S = 30.0
"""Procedural motions are made in multiples of this, so that fewer frames are the start of more."""


class SceneError(InputError):
    """A table of a scene, `key`, asks for something that cannot be made."""

    def __init__(self, scene: Scene, key: str, problem: str) -> None:
        super().__init__(f"scene '{scene.name}', key '{key}': {problem}")
        self.key, self.problem = key, problem


@contextmanager
def _table(scene: Scene, key: str) -> Iterator[None]:
    """Put what is wrong on a table of the scene; errors that name a file say enough."""
    try:
        yield
    except InputError as error:
        raise SceneError(scene, key, str(error)) from None


def stream(seed: int, purpose: str) -> np.random.Generator:
    """The random generator of one purpose under a scene's seed."""
    return np.random.default_rng([seed, zlib.crc32(purpose.encode())])


def rig_of(table: RigTable) -> Rig:
    """The scene's rig at the recorded image size."""
    path = Path(table.file) if table.file else builtin_file("rig", table.name or DEFAULT_RIG)
    rig = load_rig(path)
    return rig.resized(*table.size) if table.size else rig


def person_of(scene: Scene) -> Person:
    """The wearer: what the scene says, the rest drawn from the seed."""
    from egocap_sim.human.wardrobe import make_person

    table: PersonTable = scene.person
    headgear = table.headgear
    if headgear == "rig":
        headgear = _RIG_HEADGEAR.get(rig_of(scene.rig).name, "helmet")
    asked = table.model_dump(exclude={"headgear"}, exclude_none=True)
    worn = None if headgear == "none" else headgear
    with _table(scene, "person"):
        return make_person(scene.seed, headgear=worn, name="wearer", **asked)


def check_place(scene: Scene) -> None:
    """Raise SceneError unless there is such a place; making it, which workers do, takes longer."""
    from egocap_sim.place import PLACES

    if scene.place.name not in PLACES:
        problem = f"unknown place '{scene.place.name}' (valid: {', '.join(PLACES)})"
        raise SceneError(scene, "place.name", problem)


def place_of(scene: Scene) -> Place:
    """The surroundings."""
    from egocap_sim.place import make_place

    return make_place(
        scene.place.name, stream(scene.seed, "place"), clear_radius=scene.place.clear_radius
    )


def extras_of(scene: Scene, truth: Truth) -> list[Extra]:
    """Everything else that moves, at the frame times of `truth`: the same in every process."""
    from egocap_sim.others import make_others

    extras: list[Extra] = []
    if scene.others.count:
        extras += make_others(
            scene.others,
            stream(scene.seed, "others"),
            truth.time,
            truth.T_world_body,
            scene.place.clear_radius,
        )
    return extras


def clip_of(scene: Scene) -> Clip:
    """The reference motion, made or read."""
    motion: MotionTable = scene.motion
    if motion.file is not None:
        from egocap_sim.motion.load import load_clip

        names = Path(motion.joint_names) if motion.joint_names else None
        return load_clip(Path(motion.file), up=motion.up, unit=motion.unit, names=names)
    from egocap_sim.motion.procedural import make_motion

    assert motion.name is not None
    needed = motion.start_s + (scene.frames + 1) / scene.fps
    duration = math.ceil(needed / _MOTION_S) * _MOTION_S
    return make_motion(motion.name, duration, stream(scene.seed, "motion"), **motion.parameters)


def perform(scene: Scene, person: Person) -> Trajectory:
    """Retarget the motion to the person and play it under physics, at the cameras' frame rate."""
    from egocap_sim.motion.retarget import retarget
    from egocap_sim.physics.simulate import simulate

    with _table(scene, "motion"):
        reference = retarget(clip_of(scene), person)
        return simulate(
            person, reference, fps=scene.fps, n_frames=scene.frames, start_s=scene.motion.start_s
        )


def config_of(scene: Scene) -> dict[str, Any]:
    """All that the content of the sequence depends on, resolved, for the manifest and its hash.

    Files are named by their checksum, not by where they lie.
    """
    config = scene.model_dump(mode="json", exclude_none=True)
    config["rig"] = rig_of(scene.rig).to_dict()
    for key in ("file", "joint_names"):
        if path := config["motion"].pop(key, None):
            config["motion"][key] = {"name": Path(path).name, "sha256": _checksum(Path(path))}
    return config


def _checksum(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror}") from None
