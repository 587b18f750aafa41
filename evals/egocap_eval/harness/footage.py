"""Sequences that studies and suites work on: opened, or generated where they are missing."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING

from egocap.commandline import progress
from egocap.data.sequence import MANIFEST, Sequence, open_sequence
from egocap.errors import FileError
from egocap_eval.harness.suite import SequenceEntry, Suite

if TYPE_CHECKING:
    from egocap_sim.scene.config import Scene

log = logging.getLogger(__name__)


def prepare_sequences(
    suite: Suite, beside: Path, work: Path, motions: Path | None, workers: int
) -> dict[str, Sequence]:
    """Open every sequence, generated where it is missing. Those that need motions are left out
    without them, with a warning."""
    found = {}
    for entry in suite.sequences:
        if entry.folder is not None:
            found[entry.name] = open_sequence(beside / entry.folder)
            continue
        if entry.motion is not None and motions is None:
            log.warning("%s is left out: it needs --motions", entry.name)
            continue
        scene = _scene(entry, beside, motions)
        found[entry.name] = footage_of(scene, work / "sequences" / entry.name, workers)
    return found


def footage_of(scene: Scene, folder: Path, workers: int = 1) -> Sequence:
    """The sequence of a scene in a folder, generated or completed where it is not there.

    One that is finished is taken as it is, even of another version of the simulator: methods of
    different versions are compared on the same footage. With one worker, frames are rendered in
    this process, which is quickest for short sequences. Raises InputError for a folder of another
    scene.
    """
    from egocap_sim.record.recorder import generate

    if not (folder / MANIFEST).is_file() and workers == 1:
        with progress(scene.name, scene.frames) as advance:
            generate(scene, folder, workers=0, on_frames=advance)
        return open_sequence(folder)
    if (found := _finished(scene, folder)) is not None:
        return found
    with progress(scene.name, scene.frames) as advance:
        generate(scene, folder, workers=workers, on_frames=advance)
    return open_sequence(folder)


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
    from egocap_sim.core.resources import builtin_file
    from egocap_sim.scene.config import load_scene
    from egocap_sim.world.world import World

    assert entry.scene is not None
    own = entry.scene.endswith(".toml")
    scene = load_scene(beside / entry.scene if own else builtin_file("scene", entry.scene))
    if entry.motion is not None:
        assert motions is not None
        path = motions / entry.motion
        if not path.is_file():
            raise FileError(path, "no such clip", valid="the file under --motions")
        scene = scene.model_copy(update={"motion": type(scene.motion)(file=str(path.resolve()))})
        most = World(scene).clip_frames
        scene = scene.model_copy(update={"frames": min(entry.frames or most, most)})
    elif entry.frames is not None:
        scene = scene.model_copy(update={"frames": entry.frames})
    if entry.size is not None:
        rig = scene.rig.model_copy(update={"size": entry.size})
        scene = scene.model_copy(update={"rig": rig})
    return scene.model_copy(update={"name": entry.name})
