"""Changes of a scene by the command line or a Python call."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from egocap.errors import InputError

if TYPE_CHECKING:
    from egocap_sim.scene.config import Scene


def shown(metavar: str) -> Any:
    """Show an optional option in the help by this word, without type and default."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint="")


@dataclass(frozen=True)
class Overrides:
    """Changes of a scene. Paths are relative to the working folder."""

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
    """Time in the motion of the first frame."""
    up: Annotated[str | None, shown("y|z")] = None
    """Up axis of a BVH file; recognised when not given."""
    unit: Annotated[str | None, shown("m|cm|mm|inch|foot|cmu")] = None
    """Length unit of a BVH file; recognised when not given."""
    joint_names: Annotated[Path | None, shown("FILE")] = None
    """TOML file that maps body names to a BVH file's joint names."""
    motions: Annotated[Path | None, shown("DIR")] = None
    """A folder of BVH and npz clips to mix in, in a scene of episodes."""
    episodes: bool = False
    """Record in episodes a scene that is one sequence."""
    no_episodes: bool = False
    """Record one sequence of a scene of episodes."""
    textures: Annotated[Path | None, shown("DIR")] = None
    """A folder of pictures to put on floors and walls."""
    samples: Annotated[int | None, shown("0|2|4|8")] = None
    """Multisample anti-aliasing."""
    masks: bool = False
    """Record part labels, also where the scene does not."""
    no_masks: bool = False
    """Do not record part labels."""
    depth: bool = False
    """Record depth, also where the scene does not."""
    no_depth: bool = False
    """Do not record depth."""
    image_format: Annotated[str | None, shown("jpg|png")] = None
    """JPEG (quality 95, 4:4:4) or PNG."""
    sensor: Annotated[str | None, shown("clean|webcam|action-camera|harsh")] = None
    """A preset of camera faults, in place of the scene's own."""


UNCHANGED = Overrides()


def override_scene(scene: Scene, changes: Overrides) -> Scene:
    """Apply the changes to a scene and check it like a file.

    A scene whose motion is replaced by a file gets all the frames of it, unless `frames` is given.
    Raises InputError or FileError for a change that is not valid.
    """
    from egocap.schema import checked
    from egocap_sim.scene.config import Scene

    data = scene.model_dump(exclude_none=True)
    _set(data, "frames", changes.frames)
    _set(data, "seed", changes.seed)
    _change_record(data["record"], changes)
    _change_rig(data, changes)
    _change_motion(data, changes)
    _change_episodes(data, changes, scene.name)
    if changes.textures is not None:
        data["place"]["textures"] = str(changes.textures.resolve())
    if changes.sensor is not None:
        data["sensor"] = {"preset": changes.sensor}
    changed = checked(Scene, data, "command line")
    if changes.motion is None or changed.motion.file is None or changes.frames is not None:
        return changed
    from egocap_sim.world.world import World

    return changed.model_copy(update={"frames": World(changed).clip_frames})


def _change_record(record: dict[str, Any], changes: Overrides) -> None:
    _set(record, "samples", changes.samples)
    _set(record, "image_format", changes.image_format)
    _set(record, "masks", _switch("masks", changes.masks, changes.no_masks))
    _set(record, "depth", _switch("depth", changes.depth, changes.no_depth))


def _change_rig(data: dict[str, Any], changes: Overrides) -> None:
    from egocap_sim.core.resources import rig_names

    if changes.rig is not None:
        kept = {k: v for k, v in data["rig"].items() if k not in ("name", "file")}
        data["rig"] = kept | _source("rig", changes.rig, rig_names())
    _set(data["rig"], "size", changes.size)


def _change_motion(data: dict[str, Any], changes: Overrides) -> None:
    from egocap_sim.motion.generators.registry import MOTIONS

    if changes.motion is not None:
        data["motion"] = _source("motion", changes.motion, MOTIONS)
    names = changes.joint_names
    for key, value in (
        ("start_s", changes.start),
        ("up", changes.up),
        ("unit", changes.unit),
        ("joint_names", None if names is None else str(names.resolve())),
    ):
        _set(data["motion"], key, value)


def _change_episodes(data: dict[str, Any], changes: Overrides, scene: str) -> None:
    wanted = _switch("episodes", changes.episodes, changes.no_episodes)
    if wanted is False:
        data.pop("episodes", None)
    elif wanted:
        data.setdefault("episodes", {})
    if changes.motions is not None:
        if "episodes" not in data:
            raise InputError(
                f"--motions is for episodes, and scene '{scene}' has none",
                valid="a scene with [episodes], such as train-varied; or --motion FILE",
            )
        data["episodes"]["clips"] = str(changes.motions.resolve())


def _source(what: str, name_or_file: str, names: Collection[str]) -> dict[str, str]:
    """The table entry of a built-in name if there is one, or else of a file."""
    path = Path(name_or_file)
    if name_or_file in names:
        return {"name": name_or_file}
    if path.suffix or len(path.parts) > 1 or path.exists():
        return {"file": str(path.resolve())}
    raise InputError(f"no built-in {what} or file '{name_or_file}'", valid=names)


def _switch(name: str, on: bool, off: bool) -> bool | None:
    """The value of a pair of flags; None if neither is given."""
    if on and off:
        raise InputError(f"both --{name} and --no-{name}", valid="one of them")
    return on if on or off else None


def _set(table: dict[str, Any], key: str, value: object) -> None:
    if value is not None:
        table[key] = value
