"""Record a scene in episodes: each is a job, made in one process, with the same bytes in any."""

from __future__ import annotations

import logging
import os
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
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
from egocap.data.dataset_writer import DatasetWriter, episode_entry, replace_episode
from egocap.data.sequence_writer import digest
from egocap.errors import InputError
from egocap_sim.core.memory import release_memory
from egocap_sim.core.resources import SAMPLED
from egocap_sim.core.version import code_version
from egocap_sim.record.episode_plan import (
    ClipFile,
    check_motions,
    checksum,
    clip_files,
    draw_episode,
    find_clips,
    plan_episodes,
)
from egocap_sim.record.jobs import Executor, InProcess, Job
from egocap_sim.record.sequence_recorder import Summary, record_sequence
from egocap_sim.scene.config import Scene
from egocap_sim.scene.scene_error import errors_name_key
from egocap_sim.world.world import World

ATTEMPTS = 8  # to draw an episode that can be simulated

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class EpisodeTask:
    """Makes episodes of a scene, some of them with the motion of a clip."""

    scene: Scene
    clips: tuple[ClipFile, ...]

    def do(self, job: Job, folder: Path) -> EpisodeEntry:
        """Make an episode under a hidden name, then rename it."""
        made = folder / f".{episode_name(job.index)}.{os.getpid()}.tmp"
        shutil.rmtree(made, ignore_errors=True)
        self.make(job, made)
        entry = episode_entry(made, job.index)
        assert entry is not None, f"{made} is not complete"
        replace_episode(made, folder / entry.name)
        return entry

    def make(self, job: Job, folder: Path) -> None:
        """Make the sequence of an episode in a new folder, in this process.

        A draw may be impossible (no room for a bystander, a clip that cannot be tracked). The
        episode is then drawn again, in the same way by every worker.
        """
        for attempt in range(ATTEMPTS):
            try:
                scene = draw_episode(self.scene, job, self.clips, attempt)
                record_sequence(World(scene), folder, InProcess())
                return
            except InputError as error:
                shutil.rmtree(folder, ignore_errors=True)
                if attempt == ATTEMPTS - 1:
                    raise
                log.warning("episode %d is drawn again: %s", job.index, error)
            finally:
                release_memory()

    def portable(self) -> EpisodeTask:
        """The same task: it refers to nothing but the clips, which every machine has."""
        return self

    def close(self) -> None:
        """Nothing is held between episodes."""


def record_episodes(
    world: World,
    out: Path,
    executor: Executor,
    *,
    append: bool,
    strict: bool,
    on_frames: Callable[[int], None],
) -> Summary:
    """Make, or complete, the episodes of a scene in the folder `out`; see `recorder.generate`.

    `world` is that of the scene itself: what its episodes are drawn from.
    """
    start, scene = time.perf_counter(), world.scene
    with errors_name_key(scene.name, "episodes.motions"):
        check_motions(scene)
    clips = _clips(scene, out, strict)
    config = _config(world, clips)
    wanted = Dataset(
        schema_version=SCHEMA, name=scene.name, frames=scene.frames, parts=[scene.frames],
        seed=scene.seed, config=config, config_sha256=digest(config), code_version=code_version(),
    )  # fmt: skip
    with DatasetWriter(out, wanted, append=append) as writer:
        on_frames(sum(entry.frames for entry in writer.recording.episodes))
        writer.begin()
        done = writer.done()
        planned = plan_episodes(scene, writer.recording.parts)
        jobs = [job for job in planned if job.index not in done]

        def enter(entry: EpisodeEntry) -> None:
            writer.add(entry)
            on_frames(entry.frames)

        if jobs:
            executor.run(EpisodeTask(scene, clips), jobs, out, enter)
        recording = writer.recording
    rendered, seconds = sum(len(job.frames) for job in jobs), time.perf_counter() - start
    return Summary(
        out, recording.frames, rendered, seconds, recording.bytes, None, len(recording.episodes)
    )


def _clips(scene: Scene, out: Path, strict: bool) -> tuple[ClipFile, ...]:
    """The motion files: those of the unfinished recording if they are unchanged, or read anew."""
    assert scene.episodes is not None
    if scene.episodes.clips is None:
        return ()
    folder = Path(scene.episodes.clips)
    if not strict and (out / EPISODES).exists():
        known = load_dataset(out).config["episodes"].get("clips") or {}
        files = {str(p.relative_to(folder)): p for p in clip_files(folder)}
        found = tuple(ClipFile(str(files[name].absolute()), about["seconds"], about["sha256"])
                      for name, about in known.items() if name in files)  # fmt: skip
        if len(found) == len(known) and all(checksum(Path(c.path)) == c.sha256 for c in found):
            return found
    return find_clips(folder, strict=strict)


def _config(world: World, clips: tuple[ClipFile, ...]) -> dict[str, Any]:
    """What all episodes depend on but their number."""
    table, rig = world.scene.episodes, world.scene.rig
    config = {key: value for key, value in world.config.items() if key != "frames"}
    if rig.name == SAMPLED:  # another one in every episode
        config["rig"] = rig.model_dump(mode="json", exclude_none=True)
    if table is not None and table.clips is not None:
        folder = Path(table.clips).absolute()
        files = {
            str(Path(clip.path).relative_to(folder)): {
                "seconds": clip.seconds,
                "sha256": clip.sha256,
            }
            for clip in clips
        }
        config["episodes"] = config["episodes"] | {"clips": files}
    return config
