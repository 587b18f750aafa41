"""Record a scene in episodes. Each is one job with the same bytes in any process."""

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
from egocap.execution.jobs import Executor, InProcess
from egocap.files import sha256
from egocap_sim.core.memory import release_memory
from egocap_sim.core.resources import SAMPLED
from egocap_sim.core.version import code_version
from egocap_sim.record.episode_plan import (
    ClipFile,
    check_motions,
    clip_files,
    draw_episode,
    find_clips,
    plan_episodes,
)
from egocap_sim.record.jobs import Job
from egocap_sim.record.sequence_recorder import Summary, record_sequence
from egocap_sim.scene.config import Scene
from egocap_sim.scene.scene_error import errors_name_key
from egocap_sim.world.world import World

ATTEMPTS = 8  # draws of an episode

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class EpisodeTask:
    """Makes episodes of a scene; `clips` are the motion files to draw from."""

    scene: Scene
    clips: tuple[ClipFile, ...]

    def do(self, job: Job, folder: Path) -> EpisodeEntry:
        """Make an episode under a temporary name, then rename it."""
        made = folder / f".{episode_name(job.index)}.{os.getpid()}.tmp"
        shutil.rmtree(made, ignore_errors=True)
        self.make(job, made)
        entry = episode_entry(made, job.index)
        assert entry is not None, f"{made} is not complete"
        replace_episode(made, folder / entry.name)
        return entry

    def make(self, job: Job, folder: Path) -> None:
        """Make the sequence of an episode in a new folder, in this process.

        If a draw cannot be simulated (no room for a bystander, a clip that cannot be tracked), the
        episode is drawn again, with the same result in every worker.
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
        """The same task: it refers only to the clips, which every machine has."""
        return self

    def version(self) -> str:
        """Version of the simulator's sources."""
        return code_version()

    def close(self) -> None:
        """Do nothing: an episode releases its own resources."""


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

    `world` is the world of the scene from which the episodes are drawn.
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
        out, recording.frames, rendered, seconds, recording.bytes, None, len(recording.episodes),
        bystanders=scene.others.count,
    )  # fmt: skip


def _clips(scene: Scene, out: Path, strict: bool) -> tuple[ClipFile, ...]:
    """The motion files: of the recording in `out` if they are unchanged, or else read again."""
    assert scene.episodes is not None
    if scene.episodes.clips is None:
        return ()
    folder = Path(scene.episodes.clips)
    if not strict and (out / EPISODES).exists():
        known = load_dataset(out).config["episodes"].get("clips") or {}
        files = {str(p.relative_to(folder)): p for p in clip_files(folder)}
        found = tuple(ClipFile(str(files[name].absolute()), about["seconds"], about["sha256"])
                      for name, about in known.items() if name in files)  # fmt: skip
        if len(found) == len(known) and all(sha256(Path(c.path)) == c.sha256 for c in found):
            return found
    return find_clips(folder, strict=strict)


def _config(world: World, clips: tuple[ClipFile, ...]) -> dict[str, Any]:
    """All that the episodes depend on except their number."""
    table, rig = world.scene.episodes, world.scene.rig
    config = {key: value for key, value in world.config.items() if key != "frames"}
    if rig.name == SAMPLED:  # drawn for each episode
        config["rig"] = rig.model_dump(mode="json", exclude_none=True)
    if table is not None and table.clips is not None:
        folder = Path(table.clips).absolute()
        files = {
            str(Path(c.path).relative_to(folder)): {"seconds": c.seconds, "sha256": c.sha256}
            for c in clips
        }
        config["episodes"] = config["episodes"] | {"clips": files}
    return config
