"""Changes of a scene by the command line or a Python call."""

from __future__ import annotations

import logging
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from egocap.errors import InputError
from egocap_sim.core.resources import SAMPLED, rig_names

if TYPE_CHECKING:
    from egocap_sim.scene.config import Scene

log = logging.getLogger(__name__)


def shown(metavar: str) -> Any:
    """Show an option in the help with this placeholder, without type and default."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint="")


@dataclass(frozen=True)
class Overrides:
    """Changes of a scene. Paths are relative to the current folder."""

    frames: Annotated[int | None, shown("N")] = None
    """Number of stereo frames; of a motion file, all frames when not given."""
    seed: Annotated[int | None, shown("N")] = None
    """Seed of all random draws: person, clothes, place, style of motion."""
    rig: Annotated[str | None, shown("NAME|FILE")] = None
    """Name of a built-in rig, a rig file, or 'sampled': drawn from the seed."""
    size: Annotated[tuple[int, int] | None, shown("WIDTH HEIGHT")] = None
    """Image size in pixels; the rig is scaled to it."""
    motion: Annotated[str | None, shown("NAME|FILE")] = None
    """Name of a procedural motion, or a BVH or npz file."""
    start: Annotated[float | None, shown("SECONDS")] = None
    """Start time in the motion."""
    up: Annotated[str | None, shown("y|z")] = None
    """Up axis of a BVH file; detected when not given."""
    unit: Annotated[str | None, shown("m|cm|mm|inch|foot|cmu")] = None
    """Length unit of a BVH file; detected when not given."""
    joint_names: Annotated[Path | None, shown("FILE")] = None
    """TOML file that maps body names to a BVH file's joint names."""
    motions: Annotated[Path | None, shown("DIR")] = None
    """Folder of BVH and npz clips to use as well, in a scene with episodes."""
    episodes: bool = False
    """Record the scene in episodes, also where it has no [episodes]."""
    no_episodes: bool = False
    """Record one sequence, also where the scene has [episodes]."""
    textures: Annotated[Path | None, shown("DIR")] = None
    """Folder of images for floors and walls."""
    samples: Annotated[int | None, shown("0|2|4|8")] = None
    """Multisample anti-aliasing."""
    masks: bool = False
    """Record part labels, also where the scene disables them."""
    no_masks: bool = False
    """Do not record part labels."""
    depth: bool = False
    """Record depth, also where the scene disables it."""
    no_depth: bool = False
    """Do not record depth."""
    image_format: Annotated[str | None, shown("jpg|png")] = None
    """JPEG (quality 95, 4:4:4) or PNG."""
    sensor: Annotated[str | None, shown("PRESET")] = None
    """Preset of camera faults (`egocap-sim list`); replaces the scene's sensor."""


UNCHANGED = Overrides()
_STRETCHED = 0.02  # relative difference of width to height that is warned of


def override_scene(scene: Scene, changes: Overrides) -> Scene:
    """Apply the changes to a scene and check the result like a scene file.

    A scene without `fps` gets the rig's; with a motion file and without `frames`, all frames of the
    file. Raises InputError or FileError for a change that is not valid.
    """
    from egocap.schema import checked
    from egocap_sim.scene.config import Scene
    from egocap_sim.scene.rig_source import resolve_rig

    data = scene.model_dump(exclude_none=True)
    _replace_sources(data, changes)
    _change_episodes(data, changes, scene.name)
    record, motion = data["record"], data["motion"]
    for table, key, value in (
        (data, "frames", changes.frames),
        (data, "seed", changes.seed),
        (data["rig"], "size", changes.size),
        (motion, "start_s", changes.start),
        (motion, "up", changes.up),
        (motion, "unit", changes.unit),
        (motion, "joint_names", _absolute(changes.joint_names)),
        (data["place"], "textures", _absolute(changes.textures)),
        (record, "samples", changes.samples),
        (record, "image_format", changes.image_format),
        (record, "masks", _switch("masks", changes.masks, changes.no_masks)),
        (record, "depth", _switch("depth", changes.depth, changes.no_depth)),
        (data, "sensor", changes.sensor and {"preset": changes.sensor}),
    ):
        if value is not None:
            table[key] = value
    changed = checked(Scene, data, "command line")
    if "fps" not in scene.model_fields_set and changed.rig.name != SAMPLED:
        rate = resolve_rig(changed.rig, changed.seed).frame_rate
        changed = checked(Scene, data | {"fps": rate}, "frame_rate of the rig")
    if changes.size is not None:
        _warn_of_stretching(changed)
    if changes.motion is None or changed.motion.file is None or changes.frames is not None:
        return changed
    from egocap_sim.world.world import World

    return changed.model_copy(update={"frames": World(changed).clip_frames})


def _replace_sources(data: dict[str, Any], changes: Overrides) -> None:
    """Replace the rig and the motion by a built-in one or a file."""
    from egocap_sim.motion.generators.registry import MOTIONS

    if changes.rig is not None:
        replaced = {"name", "file"} | ({"family"} if changes.rig != SAMPLED else set())
        kept = {k: v for k, v in data["rig"].items() if k not in replaced}
        data["rig"] = kept | _source("rig", changes.rig, rig_names())
    if changes.motion is not None:
        data["motion"] = _source("motion", changes.motion, MOTIONS)


def _warn_of_stretching(scene: Scene) -> None:
    """Warn of an image size of another shape than the rig's own: its pixels are not square."""
    from egocap_sim.scene.rig_source import resolve_rig

    table = scene.rig
    if table.size is None or table.family:
        return  # a family's images keep their shape
    own = resolve_rig(table.model_copy(update={"size": None}), scene.seed).cameras[0]
    width, height = table.size
    if abs(width * own.height / (height * own.width) - 1.0) > _STRETCHED:
        log.warning("--size %d %d stretches the images: the rig's are %d x %d",
                    width, height, own.width, own.height)  # fmt: skip


def _change_episodes(data: dict[str, Any], changes: Overrides, scene: str) -> None:
    wanted = _switch("episodes", changes.episodes, changes.no_episodes)
    if wanted is False:
        data.pop("episodes", None)
    elif wanted:
        data.setdefault("episodes", {})
    if changes.motions is not None:
        if "episodes" not in data:
            raise InputError(
                f"--motions requires episodes; scene '{scene}' has none",
                valid="a scene with [episodes], such as train-varied; or --motion FILE",
            )
        data["episodes"]["clips"] = _absolute(changes.motions)
    if changes.motion is not None and "episodes" in data:
        data["episodes"]["motions"] = []
        if changes.motions is None:
            data["episodes"].pop("clips", None)
    if changes.start is not None and "episodes" in data and "file" not in data["motion"]:
        raise InputError("--start in a scene with episodes, which draw their own start times",
                         valid="--no-episodes, or --motion with a file")  # fmt: skip


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


def _absolute(path: Path | None) -> str | None:
    return None if path is None else str(path.resolve())
