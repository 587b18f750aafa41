"""What the command line changes in a scene file."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

if TYPE_CHECKING:
    from egocap_sim.scene.config import Scene


def shown(metavar: str) -> Any:
    """How an option that may be left out looks in the help: no 'None', no default."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint="")


@dataclass(frozen=True)
class Overrides:
    """What the command line changes in a scene file. Paths are relative to where you are."""

    frames: Annotated[int | None, shown("N")] = None
    """Number of stereo frames; with a motion file, all it has when not given."""
    seed: Annotated[int | None, shown("N")] = None
    """Seed of everything random: person, clothes, place, style of motion."""
    rig: Annotated[str | None, shown("NAME|FILE")] = None
    """A built-in rig's name, a rig file, or 'sampled': drawn from the seed."""
    size: Annotated[tuple[int, int] | None, shown("WIDTH HEIGHT")] = None
    """Image size in pixels; the rig is scaled to it."""
    motion: Annotated[str | None, shown("NAME|FILE")] = None
    """A procedural motion's name, or a BVH or npz clip."""
    start: Annotated[float | None, shown("SECONDS")] = None
    """Where in the motion to begin."""
    up: Annotated[str | None, shown("y|z")] = None
    """Up axis of a BVH file; recognised when not given."""
    unit: Annotated[str | None, shown("m|cm|mm|inch|foot|cmu")] = None
    """Length unit of a BVH file; recognised when not given."""
    joint_names: Annotated[Path | None, shown("FILE")] = None
    """TOML file that maps body names to a BVH file's joint names."""
    motions: Annotated[Path | None, shown("DIR")] = None
    """A folder of BVH and npz clips to mix in, in a scene of episodes."""
    episodes: Annotated[bool | None, shown("True|False")] = None
    """False: one sequence of a scene of episodes."""
    textures: Annotated[Path | None, shown("DIR")] = None
    """A folder of pictures to put on floors and walls."""
    samples: Annotated[int | None, shown("0|2|4|8")] = None
    """Multisample anti-aliasing."""
    masks: Annotated[bool | None, shown("True|False")] = None
    """Record part labels."""
    depth: Annotated[bool | None, shown("True|False")] = None
    """Record depth."""
    image_format: Annotated[str | None, shown("jpg|png")] = None
    """JPEG (quality 95, 4:4:4) or PNG."""
    sensor: Annotated[str | None, shown("clean|webcam|action-camera|harsh")] = None
    """A preset of camera faults, in place of the scene's own."""


UNCHANGED = Overrides()


def overridden(scene: Scene, asked: Overrides) -> Scene:
    """The scene with the command line's changes, checked like the file itself."""
    from egocap.errors import InputError
    from egocap.schema import checked
    from egocap_sim.core.resources import rig_names
    from egocap_sim.motion.generators.registry import MOTIONS
    from egocap_sim.scene.config import Scene

    data = scene.model_dump(exclude_none=True)
    for key in ("frames", "seed"):
        _set(data, key, getattr(asked, key))
    for key in ("samples", "masks", "depth", "image_format"):
        _set(data["record"], key, getattr(asked, key))
    if asked.rig is not None:
        data["rig"] = {k: v for k, v in data["rig"].items() if k not in ("name", "file")}
        data["rig"] |= _source("rig", asked.rig, rig_names())
    _set(data["rig"], "size", asked.size)
    if asked.motion is not None:
        data["motion"] = _source("motion", asked.motion, MOTIONS)
    for key, value in (("start_s", asked.start), ("up", asked.up), ("unit", asked.unit)):
        _set(data["motion"], key, value)
    if asked.joint_names is not None:
        data["motion"]["joint_names"] = str(asked.joint_names.resolve())
    if asked.textures is not None:
        data["place"]["textures"] = str(asked.textures.resolve())
    if asked.episodes is False:
        data.pop("episodes", None)
    elif asked.episodes and scene.episodes is None:
        data["episodes"] = {}
    if asked.motions is not None:
        if "episodes" not in data:
            raise InputError(
                f"--motions is for episodes, and scene '{scene.name}' has none",
                valid="a scene with [episodes], such as train-varied; or --motion FILE",
            )
        data["episodes"]["clips"] = str(asked.motions.resolve())
    if asked.sensor is not None:
        data["sensor"] = {"preset": asked.sensor}
    return checked(Scene, data, "command line")


def as_long_as_its_clip(scene: Scene, asked: Overrides) -> Scene:
    """Where a file replaces the motion and no frames are asked for, the scene with all it has."""
    from egocap_sim.world.stage import frames_of_clip

    if asked.motion is None or scene.motion.file is None or asked.frames is not None:
        return scene
    return scene.model_copy(update={"frames": frames_of_clip(scene)})


def _source(what: str, asked: str, names: Collection[str]) -> dict[str, str]:
    """A name where there is one of that name, or else the file of that path."""
    from egocap.errors import InputError

    path = Path(asked)
    if asked in names:
        return {"name": asked}
    if path.suffix or len(path.parts) > 1 or path.exists():
        return {"file": str(path.resolve())}
    raise InputError(f"no built-in {what} or file '{asked}'", valid=names)


def _set(table: dict, key: str, value: object) -> None:
    if value is not None:
        table[key] = value
