"""Record a scene in episodes: whole episodes made by worker processes, resumable anywhere.

A worker prepares and renders one episode after another; while it prepares one, others render. The
bytes of an episode are the same whoever makes it.
"""

from __future__ import annotations

import logging
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from egocap.data.dataset import (
    EPISODES,
    SCHEMA,
    Dataset,
    EpisodeEntry,
    episode_name,
    load_dataset,
)
from egocap.data.dataset_writer import DatasetWriter, episode_entry, put_in_place
from egocap.data.sequence_writer import digest
from egocap.errors import InputError
from egocap.files import write_atomically
from egocap_sim.core.memory import give_back
from egocap_sim.core.resources import SAMPLED
from egocap_sim.core.version import code_version
from egocap_sim.record.episode_plan import (
    Episode,
    Recorded,
    catalogue,
    check_motions,
    checksum,
    clip_files,
    plan,
    scene_of,
)
from egocap_sim.record.workers import work_through
from egocap_sim.scene.config import Scene
from egocap_sim.world.stage import SceneError, config_of
from egocap_sim.world.surroundings import check_place, check_things

ATTEMPTS = 8  # at an episode whose draw is impossible, before that is an error

log = logging.getLogger(__name__)


def record_episodes(
    scene: Scene,
    out: Path,
    *,
    workers: int,
    cluster: str | None,
    append: bool,
    strict: bool,
    on_frames: Callable[[int], None],
) -> tuple[Dataset, int]:
    """Make, or complete, a recording; the recording and the frames made now."""
    check_place(scene)
    check_things(scene)
    try:
        check_motions(scene)
    except InputError as error:
        raise SceneError(scene, "episodes.motions", str(error)) from None
    clips = _clips(scene, out, strict)
    config = _config(scene, clips)
    asked = Dataset(
        schema_version=SCHEMA, name=scene.name, frames=scene.frames, parts=[scene.frames],
        seed=scene.seed, config=config, config_sha256=digest(config), code_version=code_version(),
    )  # fmt: skip
    with DatasetWriter(out, asked, append=append) as writer:
        on_frames(sum(entry.frames for entry in writer.recording.episodes))
        writer.begin()
        done = writer.done()
        left = {e.index: e for e in plan(scene, writer.recording.parts) if e.index not in done}
        rendered = sum(episode.frames for episode in left.values())

        def enter(entry: EpisodeEntry) -> None:
            writer.enter(entry)
            on_frames(entry.frames)

        if cluster is not None:
            from egocap_sim.record.cluster import record_on_cluster

            record_on_cluster(cluster, scene, out, left, clips, enter)
        elif left:
            work_through(left, _record, (_begin, scene, out, clips), workers, enter,
                         lambda: _tidy(out))  # fmt: skip
        return writer.recording, rendered


def make_episode(scene: Scene, episode: Episode, clips: tuple[Recorded, ...], folder: Path) -> None:
    """Make one episode in a new folder, in this process.

    What a draw asked for may be impossible (no room for a person, a clip nobody could follow); it
    is then drawn again, the same everywhere.
    """
    from egocap_sim.record.recorder import record_here

    for attempt in range(ATTEMPTS):
        try:
            record_here(scene_of(scene, episode, clips, attempt), folder)
            return
        except InputError as error:
            shutil.rmtree(folder, ignore_errors=True)
            if attempt == ATTEMPTS - 1:
                raise
            log.warning("episode %d is drawn again: %s", episode.index, error)
        finally:
            give_back()


_task: tuple[Scene, Path, tuple[Recorded, ...]]


def _begin(scene: Scene, out: Path, clips: tuple[Recorded, ...]) -> None:
    global _task
    _task = scene, out, clips


def _record(index: int, episode: Episode) -> EpisodeEntry:
    """In a worker: make an episode and give it its name."""
    scene, out, clips = _task
    made = out / f".{episode_name(index)}.{os.getpid()}.tmp"
    shutil.rmtree(made, ignore_errors=True)
    make_episode(scene, episode, clips, made)
    return _placed(made, out, index)


def _placed(made: Path, out: Path, index: int) -> EpisodeEntry:
    entry = episode_entry(made, index)
    assert entry is not None, f"{made} is not whole"
    put_in_place(made, out / episode_name(index))
    return entry


def episode_files(scene: Scene, episode: Episode, clips: tuple[Recorded, ...]) -> dict[str, bytes]:
    """Make one episode; its files by name."""
    with tempfile.TemporaryDirectory(prefix="egocap-") as folder:
        made = Path(folder) / episode_name(episode.index)
        make_episode(scene, episode, clips, made)
        return {path.name: path.read_bytes() for path in sorted(made.iterdir())}


def place_files(files: dict[str, bytes], out: Path, index: int) -> EpisodeEntry:
    """Put an episode that was made elsewhere in place."""
    made = out / f".{episode_name(index)}.{os.getpid()}.tmp"
    shutil.rmtree(made, ignore_errors=True)
    made.mkdir()
    for name, content in files.items():
        write_atomically(made / name, content)
    return _placed(made, out, index)


def _tidy(out: Path) -> None:
    for leftover in out.glob(".episode-*.tmp"):
        shutil.rmtree(leftover, ignore_errors=True)


def _clips(scene: Scene, out: Path, strict: bool) -> tuple[Recorded, ...]:
    """The motion files: as an unfinished recording knows them, or looked at one by one."""
    assert scene.episodes is not None
    if scene.episodes.clips is None:
        return ()
    folder = Path(scene.episodes.clips)
    if not strict and (out / EPISODES).exists():
        known = load_dataset(out).config["episodes"].get("clips") or {}
        files = {str(p.relative_to(folder)): p for p in clip_files(folder)}
        found = tuple(Recorded(str(files[name].absolute()), about["seconds"], about["sha256"])
                      for name, about in known.items() if name in files)  # fmt: skip
        if len(found) == len(known) and all(checksum(Path(c.path)) == c.sha256 for c in found):
            return found
    return catalogue(folder, strict=strict)


def _config(scene: Scene, clips: tuple[Recorded, ...]) -> dict[str, Any]:
    config = config_of(scene)
    del config["frames"]
    if scene.rig.name == SAMPLED:  # another one in every episode
        config["rig"] = scene.rig.model_dump(mode="json", exclude_none=True)
    if scene.episodes is not None and scene.episodes.clips is not None:
        folder = Path(scene.episodes.clips).absolute()
        config["episodes"]["clips"] = {
            str(Path(clip.path).relative_to(folder)): {
                "seconds": clip.seconds, "sha256": clip.sha256,
            } for clip in clips
        }  # fmt: skip
    return config
