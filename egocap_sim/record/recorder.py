"""Record a scene as a sequence or as a data set of episodes."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

from egocap.errors import InputError
from egocap.execution.choice import choose_executor
from egocap.execution.jobs import Executor
from egocap_sim.record.compile_ahead import compiling_ahead
from egocap_sim.record.episode_recorder import record_episodes
from egocap_sim.record.sequence_recorder import Summary, record_sequence
from egocap_sim.scene.config import Scene
from egocap_sim.scene.scene_error import errors_name_key
from egocap_sim.world.world import World, build_world

log = logging.getLogger(__name__)

_SHORT = 100  # frames; starting two workers takes as long as they save on 100 to 200


def generate(
    scene: Scene,
    out: Path,
    *,
    workers: int | None = None,
    cluster: str | None = None,
    append: bool = False,
    strict: bool = False,
    on_frames: Callable[[int], None] = lambda frames: None,
) -> Summary:
    """Record the sequence or the episodes of a scene in the folder `out`, or complete them.

    Args:
        scene: scene to simulate.
        out: folder of the sequence; it is created, or holds an unfinished run of the same scene.
        workers: processes that render; 0: this one. None: 0 for a sequence so short that starting
            others takes longer than they save, else 2.
        cluster: address of a Dask scheduler whose workers render instead.
        append: extend a finished sequence of fewer frames.
        strict: raise for a motion file of [episodes] that cannot be read, instead of skipping it,
            and for a suspect motion file (`egocap_sim.motion.clips.clip_check`).
        on_frames: called with the number of frames of an earlier run, then with the number of
            frames of each finished shard or episode.

    Raises SceneError, InputError or FileError for a bad scene, motion or output folder, before
    anything is written; MachineError when GL is missing, the disk is full or workers keep dying.
    """
    with compiling_ahead():
        executor, world = _executor(scene, workers, cluster), build_world(scene)
        if scene.episodes is None:
            _report_motions(world, strict)
            return record_sequence(world, out, executor, append=append, on_frames=on_frames)
        return record_episodes(
            world, out, executor, append=append, strict=strict, on_frames=on_frames
        )


def _report_motions(world: World, strict: bool) -> None:
    """Log what was found and repaired in the motion files, or raise for a suspect one."""
    with errors_name_key(world.scene.name, "motion"):
        reports = world.motion.reports()
    for report in reports:
        if report.suspect and strict:
            raise InputError(
                f"motion '{report.name}' is suspect: {report.severe_text()}",
                valid="another motion file, or no --strict",
            )
        for finding in report.findings:
            log.log(logging.WARNING if finding.severe else logging.INFO, "%s: %s",
                    report.name, finding)  # fmt: skip


def _executor(scene: Scene, workers: int | None, cluster: str | None) -> Executor:
    if workers is None:
        workers = 0 if scene.episodes is None and scene.frames <= _SHORT else 2
    return choose_executor(workers, cluster)
