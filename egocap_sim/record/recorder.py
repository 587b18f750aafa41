"""Record a scene as a sequence or as a data set of episodes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from egocap_sim.record.episode_recorder import record_episodes
from egocap_sim.record.jobs import Executor, InProcess
from egocap_sim.record.process_pool import ProcessPool
from egocap_sim.record.sequence_recorder import Summary, record_sequence
from egocap_sim.scene.config import Scene
from egocap_sim.world.world import build_world


def generate(
    scene: Scene,
    out: Path,
    *,
    workers: int = 1,
    cluster: str | None = None,
    append: bool = False,
    strict: bool = False,
    on_frames: Callable[[int], None] = lambda frames: None,
) -> Summary:
    """Record the sequence or the episodes of a scene in the folder `out`, or complete them.

    Args:
        scene: scene to simulate.
        out: folder of the sequence; it is created, or holds an unfinished run of the same scene.
        workers: processes that render; 0: this one.
        cluster: address of a Dask scheduler whose workers render instead.
        append: extend a finished sequence of fewer frames.
        strict: raise for a motion file of [episodes] that cannot be read, instead of skipping it.
        on_frames: called with the number of frames of an earlier run, then with the number of
            frames of each finished shard or episode.

    Raises SceneError, InputError or FileError for a bad scene, motion or output folder, before
    anything is written; MachineError when GL is missing, the disk is full or workers keep dying.
    """
    world, executor = build_world(scene), _executor(workers, cluster)
    if scene.episodes is None:
        return record_sequence(world, out, executor, append=append, on_frames=on_frames)
    return record_episodes(world, out, executor, append=append, strict=strict, on_frames=on_frames)


def _executor(workers: int, cluster: str | None) -> Executor:
    if cluster is None:
        return ProcessPool(workers) if workers else InProcess()
    from egocap_sim.record.cluster import DaskCluster

    return DaskCluster(cluster)
