"""Sequences that studies and suites work on: opened, or generated where they are missing."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from egocap.commandline import progress
from egocap.data.manifest import MANIFEST
from egocap.data.sequence import Sequence, open_sequence
from egocap.errors import FileError
from egocap_eval.harness.suite import SequenceEntry, Suite

if TYPE_CHECKING:
    from egocap_sim.scene.config import Scene

log = logging.getLogger(__name__)


def prepare_sequences(
    suite: Suite,
    beside: Path,
    work: Path,
    motions: Path | None,
    workers: int,
    cluster: str | None = None,
) -> dict[str, Sequence]:
    """Open every sequence of a suite, generated where missing.

    Without `motions`, sequences that need a clip are left out with a warning.
    """
    found = {}
    for entry in suite.sequences:
        if entry.folder is not None:
            found[entry.name] = open_sequence(beside / entry.folder)
            continue
        if entry.motion is not None and motions is None:
            log.warning("%s is left out: it needs --motions", entry.name)
            continue
        scene = _scene(entry, beside, motions)
        folder = work / "sequences" / entry.name
        found[entry.name] = prepare_sequence(scene, folder, workers, cluster)
    return found


def prepare_sequence(
    scene: Scene, folder: Path, workers: int = 1, cluster: str | None = None
) -> Sequence:
    """Open the sequence of a scene, generated or completed where it is missing.

    A complete sequence is not made again, even if another version of the simulator made it, so
    that versions of a method are compared on the same footage. One worker renders in this process,
    which is fastest for short sequences; with the address of a Dask scheduler its workers render.
    Raises InputError for a folder of another scene.
    """
    from egocap_sim.record.recorder import generate

    in_process = workers == 1 and cluster is None and not (folder / MANIFEST).is_file()
    if not in_process and (found := _finished(scene, folder)) is not None:
        return found
    with progress(scene.name, scene.frames) as advance:
        workers = 0 if in_process else workers
        generate(scene, folder, workers=workers, cluster=cluster, on_frames=advance)
    return open_sequence(folder)


def content_hashes(sequences: Iterable[Sequence]) -> dict[str, dict[str, str]]:
    """What a result depends on of its footage, JSON-ready: each sequence's hash by name."""
    return {"sequences": {s.manifest.name: s.manifest.config_sha256 for s in sequences}}


def builtin_scene(name: str, size: tuple[int, int] | None = None, **changes: Any) -> Scene:
    """A built-in scene with another image size and other settings."""
    from egocap_sim.core.resources import builtin_file
    from egocap_sim.scene.config import load_scene

    scene = load_scene(builtin_file("scene", name)).model_copy(update=changes)
    return scene if size is None else resized(scene, size)


def resized(scene: Scene, size: tuple[int, int]) -> Scene:
    """The scene with another image width and height, pixels."""
    return scene.model_copy(update={"rig": scene.rig.model_copy(update={"size": size})})


def with_clip(scene: Scene, path: Path, most_frames: int | None) -> Scene:
    """The scene with a clip as its motion, at most as long as the clip. Raises FileError."""
    from egocap_sim.world.world import World

    if not path.is_file():
        raise FileError(path, "no such clip", valid="a folder with the validation clips")
    motion = type(scene.motion)(file=str(path.resolve()))
    scene = scene.model_copy(update={"motion": motion})
    frames = World(scene).clip_frames
    return scene.model_copy(update={"frames": min(most_frames or frames, frames)})


def _finished(scene: Scene, folder: Path) -> Sequence | None:
    from egocap.data.sequence_writer import digest
    from egocap_sim.world.world import World

    try:
        found = open_sequence(folder)
    except FileError:
        return None
    manifest = found.manifest
    if not manifest.complete or manifest.config_sha256 != digest(World(scene).config):
        return None
    return found


def _scene(entry: SequenceEntry, beside: Path, motions: Path | None) -> Scene:
    from egocap_sim.scene.config import load_scene

    assert entry.scene is not None
    own = entry.scene.endswith(".toml")
    scene = load_scene(beside / entry.scene) if own else builtin_scene(entry.scene)
    if entry.motion is not None:
        assert motions is not None
        scene = with_clip(scene, motions / entry.motion, entry.frames)
    elif entry.frames is not None:
        scene = scene.model_copy(update={"frames": entry.frames})
    if entry.size is not None:
        scene = resized(scene, entry.size)
    return scene.model_copy(update={"name": entry.name})
