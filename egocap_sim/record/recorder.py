"""Generate a sequence: physics once, then shards rendered by worker processes, resumable anywhere.

The parent owns the manifest; workers (spawned, since a fork after a GL context hangs) each hold one
renderer and write whole shards. A scene and seed give the same bytes for any number of workers.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from egocap.cameras.rig import Rig
from egocap.cameras.rig_files import load_rig
from egocap.data.sequence import (
    OTHERS,
    SCHEMA,
    SENSOR,
    TRUE_RIG,
    Manifest,
    OthersTruth,
    Sequence,
    ShardEntry,
    Truth,
)
from egocap.data.sequence_writer import SequenceWriter, digest, write_shard
from egocap.errors import InputError
from egocap.files import disk_errors
from egocap_sim.core.trajectory import PhysicsStats
from egocap_sim.core.version import code_version
from egocap_sim.record.workers import DRAFT, files_of, frame_maker, render_locally
from egocap_sim.scene.config import Scene, to_toml
from egocap_sim.sensor.plan import SensorPlan, plan_sensor
from egocap_sim.truth.truth import others_truth, truth_before_rendering
from egocap_sim.world.stage import (
    calibrated_rig_of,
    config_of,
    perform,
    perform_finely,
    person_of,
    rig_of,
    sensor_of,
)
from egocap_sim.world.surroundings import check_place, check_things, clear_radius_of

if TYPE_CHECKING:
    from egocap_sim.human.body.person import Person


@dataclass(frozen=True)
class Summary:
    """What a generation run did."""

    folder: Path
    frames: int  # of the whole sequence
    rendered: int  # in this run
    seconds: float  # rendering wall time of this run
    bytes: int
    physics: PhysicsStats | None  # None when nothing was left to do, and of episodes
    episodes: int = 0  # 0: a single sequence

    @property
    def people(self) -> int:
        """Wearers: every episode has another."""
        return self.episodes or 1

    @property
    def frames_per_second(self) -> float:
        """Stereo frames rendered and written a second in this run; nan when none were."""
        return self.rendered / self.seconds if self.rendered else float("nan")


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
    """Make, or complete, the sequence of a scene in folder `out`; or its episodes.

    Shards are rendered by `workers` processes here or, where `cluster` is the address of a Dask
    scheduler, by its workers. With `append`, a sequence of fewer frames is made longer. With
    `strict`, a motion file that cannot be read is an error and is not left out.
    `on_frames` is called with the number of frames each finished shard adds, first with those an
    earlier run left. Raises SceneError, InputError or FileError for a bad scene, motion or output
    folder, before anything is written; MachineError when GL is missing, the disk is full or a
    worker dies.
    """
    if scene.episodes is not None:
        from egocap_sim.record.episode_recorder import record_episodes

        start = time.perf_counter()
        recording, rendered = record_episodes(
            scene, out, workers=workers, cluster=cluster, append=append, strict=strict,
            on_frames=on_frames,
        )  # fmt: skip
        seconds = time.perf_counter() - start
        return Summary(out, recording.frames, rendered, seconds, recording.bytes, None,
                       len(recording.episodes))  # fmt: skip
    check_place(scene)
    check_things(scene)
    person = person_of(scene)
    manifest, side_files = _manifest(scene), _side_files(scene, person)
    with SequenceWriter(out, manifest, side_files, append=append) as writer:
        on_frames(sum(len(shard.frames) for shard in writer.manifest.shards))
        if writer.manifest.complete:
            return Summary(out, scene.frames, 0, 0.0, _size(out), None)
        draft, sensor_plan, stats = _staged(scene, person)
        if writer.old_truth is not None:
            _check_start(scene, writer.old_truth, draft)
        writer.begin()
        with disk_errors(out):
            draft.save(out / DRAFT)
            if sensor_plan is not None:
                sensor_plan.save(out)
        pending = [(i, writer.frames_of(i)) for i in writer.pending()]
        start = time.perf_counter()

        def enter(entry: ShardEntry) -> None:
            writer.enter_shard(entry)
            on_frames(len(entry.frames))

        _render(scene, out, pending, workers, cluster, enter)
        seconds = time.perf_counter() - start
        _finish(writer, draft, sensor_plan)
    rendered = sum(len(frames) for _, frames in pending)
    return Summary(out, scene.frames, rendered, seconds, _size(out), stats)


def record_here(scene: Scene, folder: Path) -> None:
    """Make the sequence of a scene in a new folder, in this process and thread alone."""
    person = person_of(scene)
    with SequenceWriter(folder, _manifest(scene), _side_files(scene, person)) as writer:
        draft, sensor_plan, _ = _staged(scene, person)
        writer.begin()
        maker = frame_maker(scene, person, draft, sensor_plan)
        try:
            for index in writer.pending():
                frames = writer.frames_of(index)
                shard = write_shard(folder, index, frames.start, files_of(maker, frames))
                writer.enter_shard(shard)
        finally:
            maker.close()
        _finish(writer, draft, sensor_plan)


def _manifest(scene: Scene) -> Manifest:
    config = config_of(scene)
    return Manifest(
        schema_version=SCHEMA,
        name=scene.name,
        fps=scene.fps,
        frames=scene.frames,
        shard_frames=scene.record.shard_frames,
        views=rig_of(scene.rig, scene.seed).views,
        seed=scene.seed,
        config=config,
        config_sha256=digest(config),
        code_version=code_version(),
    )


def _staged(scene: Scene, person: Person) -> tuple[Truth, SensorPlan | None, PhysicsStats]:
    """The motion under physics: truth before rendering, and what the sensor will do to it."""
    rig, sensor, poses = rig_of(scene.rig, scene.seed), sensor_of(scene), None
    if sensor is not None and sensor.timed:
        trajectory, poses = perform_finely(scene, person)
    else:
        trajectory = perform(scene, person)
    draft = truth_before_rendering(person, trajectory, rig)
    if sensor is None:
        return draft, None, trajectory.stats
    sensor_plan, draft = plan_sensor(draft, person, poses, rig, sensor, scene.seed)
    return draft, sensor_plan, trajectory.stats


def _check_start(scene: Scene, old: Truth, new: Truth) -> None:
    """Raise InputError unless a longer sequence begins as the shorter one that is there."""
    frames = len(old.time)
    alike = np.array_equal(old.T_world_body, new.T_world_body[:frames])
    if not alike or clear_radius_of(scene, old) != clear_radius_of(scene, new):
        raise InputError(
            "the sequence cannot be made longer: with more frames its beginning would differ",
            valid="another --out",
        )


def _side_files(scene: Scene, person: Person) -> dict[str, bytes]:
    from egocap_sim.truth.proportions import proportions_of

    rig = rig_of(scene.rig, scene.seed)
    found = calibrated_rig_of(scene)  # what a calibration found, which trackers go by
    true_rig = {} if found == rig else {TRUE_RIG: _rig_file(rig)}
    return true_rig | {
        "rig.json": _rig_file(found),
        "scene.toml": to_toml(scene).encode(),
        "body.json": (json.dumps(proportions_of(person).to_dict(), indent=1) + "\n").encode(),
        "person.json": (json.dumps(dict(person.description), indent=1) + "\n").encode(),
    }


def _rig_file(rig: Rig) -> bytes:
    return (json.dumps(rig.to_dict(), indent=1) + "\n").encode()


def _render(
    scene: Scene,
    out: Path,
    pending: list[tuple[int, range]],
    workers: int,
    cluster: str | None,
    enter: Callable[[ShardEntry], None],
) -> None:
    if cluster is None:
        render_locally(scene, out, pending, workers, enter)
    else:
        from egocap_sim.record.cluster import render_on_cluster

        render_on_cluster(cluster, scene, out, pending, enter)


def _finish(writer: SequenceWriter, draft: Truth, sensor_plan: SensorPlan | None) -> None:
    """Complete the truth with what rendering found, and record it last of all."""
    sequence = _Shards(writer)
    visibility = np.stack([sequence.visibility(i) for i in range(writer.manifest.frames)])
    truth = replace(draft, visibility=visibility)
    if sensor_plan is not None:
        writer.write_file(SENSOR, sensor_plan.applied.content())
        sensor_plan.discard(writer.folder)
    if (others := sequence.others_of(truth)) is not None:
        writer.write_file(OTHERS, others.content())
    writer.write_file("truth.npz", truth.content())
    (writer.folder / DRAFT).unlink(missing_ok=True)


class _Shards(Sequence):
    """The frames of a sequence whose shards are all there but whose truth is not yet."""

    def __init__(self, writer: SequenceWriter) -> None:
        self.folder, self.manifest = writer.folder, writer.manifest

    def visibility(self, index: int) -> np.ndarray:
        recorded = self.annotation(index)["visibility"]
        return np.array([recorded[view] for view in self.manifest.views], np.uint8)

    def others_of(self, truth: Truth) -> OthersTruth | None:
        """The other people's joints as the annotations have them."""
        found = [self.annotation(i).get("others") for i in range(self.manifest.frames)]
        if None in found:
            return None
        return others_truth(np.array(found), truth.T_world_head, load_rig(self._rig_path))

    @property
    def _rig_path(self) -> Path:
        true = self.folder / TRUE_RIG
        return true if true.exists() else self.folder / "rig.json"


def _size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.iterdir() if path.is_file())
