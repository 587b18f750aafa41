"""Record one sequence: simulate the motion once, then render its shards as jobs.

One process writes the manifest. The bytes are the same for any executor and number of workers.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array

from egocap.cameras.rig import Rig
from egocap.data.manifest import SCHEMA, Manifest, ShardEntry, load_manifest
from egocap.data.sequence import OTHERS, SENSOR, TRUE_RIG, Sequence
from egocap.data.sequence_writer import SequenceWriter, digest, write_shard
from egocap.data.truth import Truth
from egocap.errors import InputError
from egocap.execution.jobs import Executor
from egocap.execution.process_pool import count_frames
from egocap_sim.core.trajectory import PhysicsStats
from egocap_sim.core.version import code_version
from egocap_sim.motion.clips.clip_check import ClipReport
from egocap_sim.record.jobs import Job
from egocap_sim.scene.config import Scene, to_toml
from egocap_sim.truth.proportions import measure_proportions
from egocap_sim.truth.truth import others_truth
from egocap_sim.world.take import Take, read_drafts, remove_drafts
from egocap_sim.world.world import World, load_world

if TYPE_CHECKING:
    from egocap_sim.assets.mesh import AnimatedActor
    from egocap_sim.record.frame_writer import FrameWriter

_STEP_M = 0.002  # of bystanders and things where an appended part begins, at most


@dataclass(frozen=True)
class Summary:
    """The result of one run."""

    folder: Path
    frames: int  # of the whole sequence
    rendered: int  # in this run
    seconds: float  # rendering wall time of this run
    bytes: int
    physics: PhysicsStats | None  # None if the recording was complete, and of episodes
    episodes: int = 0  # 0: a single sequence
    motions: tuple[ClipReport, ...] = ()  # what is wrong with the motion files
    bystanders: int = 0  # other people in every scene

    @property
    def people(self) -> int:
        """Number of wearers: one an episode."""
        return self.episodes or 1

    @property
    def frames_per_second(self) -> float:
        """Stereo frames rendered and written a second in this run; nan without frames."""
        return self.rendered / self.seconds if self.rendered else float("nan")


class ShardTask:
    """Renders shards of a sequence; a worker creates its renderer with the first shard."""

    def __init__(
        self, scene: Scene, drafts: Path | Mapping[str, bytes], world: World | None = None
    ) -> None:
        """`drafts`: folder of the saved take, or its files. `world`: if it is in this process."""
        self._scene, self._drafts, self._world = scene, drafts, world
        self._writer: FrameWriter | None = None

    def do(self, job: Job, folder: Path) -> ShardEntry:
        """Render the frames of a shard and write it."""
        if self._writer is None:
            from egocap_sim.record.frame_writer import FrameWriter

            self._writer = FrameWriter(self._world or load_world(self._scene, self._drafts))
        files = count_frames(self._writer.files(job.frames))
        return write_shard(folder, job.index, job.frames.start, files)

    def portable(self) -> ShardTask:
        """The same task with the content of the drafts instead of their folder."""
        drafts = self._drafts
        return ShardTask(self._scene, read_drafts(drafts) if isinstance(drafts, Path) else drafts)

    def version(self) -> str:
        """Version of the simulator's sources."""
        return code_version()

    def close(self) -> None:
        """Release the GL context."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None


def record_sequence(
    world: World,
    out: Path,
    executor: Executor,
    *,
    append: bool = False,
    on_frames: Callable[[int], None] = lambda frames: None,
) -> Summary:
    """Make, or complete, the sequence of a world in the folder `out`; see `recorder.generate`."""
    scene, others = world.scene, world.scene.others.count
    with SequenceWriter(out, _manifest(world), _side_files(world), append=append) as writer:
        left = sum(len(writer.shard_range(i)) for i in writer.pending())
        on_frames(writer.manifest.frames - left)
        if writer.manifest.complete:
            return Summary(out, scene.frames, 0, 0.0, _size(out), None, bystanders=others)
        take = world.take
        _ = world.clear_radius  # raises for a motion that leaves the place
        if writer.old_truth is not None:
            _check_start(world, writer.old_truth)
        writer.begin()
        if executor.separate:
            take.save(out)
        jobs = [Job(i, writer.shard_range(i), scene.seed) for i in writer.pending()]
        start = time.perf_counter()

        def enter(entry: ShardEntry) -> None:
            writer.add_shard(entry)
            on_frames(len(entry.frames))

        if jobs:
            task = ShardTask(scene, out, None if executor.separate else world)
            executor.run(task, jobs, out, enter)
        seconds = time.perf_counter() - start
        _finish(writer, take)
    rendered = sum(len(job.frames) for job in jobs)
    stats = world.trajectory.stats
    motions = tuple(world.motion.reports())
    return Summary(
        out, scene.frames, rendered, seconds, _size(out), stats, motions=motions, bystanders=others
    )


def _manifest(world: World) -> Manifest:
    scene = world.scene
    return Manifest(
        schema_version=SCHEMA,
        name=scene.name,
        fps=scene.fps,
        frames=scene.frames,
        shard_frames=scene.record.shard_frames,
        views=world.rig.views,
        seed=scene.seed,
        config=world.config,
        config_sha256=digest(world.config),
        code_version=code_version(),
    )


def _check_start(world: World, old: Truth) -> None:
    """Raise InputError unless the longer sequence begins with the recorded shorter one."""
    before = World(world.scene, Take(old, None))
    moves = np.array_equal(old.T_world_body, world.take.truth.T_world_body[: len(old.time)])
    if not moves or before.clear_radius != world.clear_radius:
        differs = "its beginning"
    elif not all(map(_begins_like, world.actors, before.actors)):
        differs = "the bystanders or things in its beginning"
    else:
        return
    raise InputError(
        f"the sequence cannot be extended: with more frames {differs} would differ",
        valid="another --out",
    )


def _begins_like(longer: AnimatedActor, shorter: AnimatedActor) -> bool:
    """Whether both look alike and, in the frames of the shorter, move alike."""
    a, b = longer.actor.meshes, shorter.actor.meshes
    return (
        len(a) == len(b)
        and all(
            np.array_equal(m.texture, n.texture) and _alike(m.vertices, n.vertices)
            for m, n in zip(a, b, strict=True)
        )
        and _alike(longer.skinning[: len(shorter.skinning)], shorter.skinning)
    )


def _alike(a: Array, b: Array) -> bool:
    return a.shape == b.shape and np.allclose(a, b, rtol=0, atol=_STEP_M)


def _side_files(world: World) -> dict[str, bytes]:
    rig, calibrated = world.rig, world.calibrated_rig
    true_rig = {} if calibrated == rig else {TRUE_RIG: _rig_file(rig)}
    return true_rig | {
        "rig.json": _rig_file(calibrated),
        "scene.toml": to_toml(world.scene).encode(),
        "body.json": _json_file(measure_proportions(world.person).to_dict()),
        "person.json": _json_file(dict(world.person.description)),
    }


def _rig_file(rig: Rig) -> bytes:
    return _json_file(rig.to_dict())


def _json_file(content: object) -> bytes:
    return (json.dumps(content, indent=1) + "\n").encode()


def _finish(writer: SequenceWriter, take: Take) -> None:
    """Add the rendered visibility to the truth and write the truth as the last file."""
    shards = _Shards(writer)
    visibility, people = [], []
    for i in range(writer.manifest.frames):  # one at a time: they are twice as large as the truth
        annotation = shards.annotation(i)
        visibility.append(shards.labels(i, annotation)[1])
        if "others" in annotation:
            people.append(np.array(annotation["others"]))
    truth = replace(take.truth, visibility=np.array(visibility))
    if take.sensor_plan is not None:
        writer.write_file(SENSOR, take.sensor_plan.applied.content())
    if people:
        others = others_truth(np.array(people), truth.T_world_head, shards.true_rig)
        writer.write_file(OTHERS, others.content())
    writer.write_file("truth.npz", truth.content())
    remove_drafts(writer.folder)


class _Shards(Sequence):
    """The frames of a sequence that has all shards but no truth yet."""

    def __init__(self, writer: SequenceWriter) -> None:
        self.folder, self.manifest = writer.folder, load_manifest(writer.folder)


def _size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.iterdir() if path.is_file())
