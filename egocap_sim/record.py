"""Generate a sequence: physics once, then shards rendered by worker processes, resumable anywhere.

The parent owns the manifest; workers (spawned, since a fork after a GL context hangs) each hold one
renderer and write whole shards. A scene and seed give the same bytes for any number of workers.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from egocap.rig import Rig
from egocap.sequence import (
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
from egocap.sequence_writer import SequenceWriter, disk_errors
from egocap_sim.scene import Scene, to_toml
from egocap_sim.sensor.film import Film, load_film
from egocap_sim.stage import (
    calibrated_rig_of,
    check_place,
    check_things,
    config_of,
    perform,
    perform_finely,
    person_of,
    rig_of,
    sensor_of,
)
from egocap_sim.trajectory import PhysicsStats
from egocap_sim.truth import others_truth, truth_before_rendering
from egocap_sim.version import code_version
from egocap_sim.workers import DRAFT, render_locally

if TYPE_CHECKING:
    pass


@dataclass(frozen=True)
class Summary:
    """What a generation run did."""

    folder: Path
    frames: int  # of the whole sequence
    rendered: int  # in this run
    seconds: float  # rendering wall time of this run
    bytes: int
    physics: PhysicsStats | None  # None when nothing was left to do

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
    on_frames: Callable[[int], None] = lambda frames: None,
) -> Summary:
    """Make, or complete, the sequence of a scene in folder `out`.

    Shards are rendered by `workers` processes here or, where `cluster` is the address of a Dask
    scheduler, by its workers.
    `on_frames` is called with the number of frames each finished shard adds, first with those an
    earlier run left. Raises SceneError, InputError or FileError for a bad scene, motion or output
    folder, before anything is written; MachineError when GL is missing, the disk is full or a
    worker dies.
    """
    config = config_of(scene)
    rig = rig_of(scene.rig, scene.seed)
    manifest = Manifest(
        schema_version=SCHEMA,
        name=scene.name,
        fps=scene.fps,
        frames=scene.frames,
        shard_frames=scene.record.shard_frames,
        views=rig.views,
        seed=scene.seed,
        config=config,
        config_sha256=_digest(config),
        code_version=code_version(),
    )
    check_place(scene)
    check_things(scene)
    person = person_of(scene)
    sensor = sensor_of(scene)
    side_files = _side_files(scene, rig, person)
    with SequenceWriter(out, manifest, side_files) as writer:
        on_frames(sum(len(shard.frames) for shard in writer.manifest.shards))
        if writer.manifest.complete:
            return Summary(out, scene.frames, 0, 0.0, _size(out), None)
        film, poses = None, None
        if sensor is not None and sensor.timed:
            trajectory, poses = perform_finely(scene, person)
        else:
            trajectory = perform(scene, person)
        draft = truth_before_rendering(person, trajectory, rig)
        if sensor is not None:
            film, draft = load_film(draft, person, poses, rig, sensor, scene.seed)
        writer.begin()
        with disk_errors(out):
            draft.save(out / DRAFT)
            if film is not None:
                film.save(out)
        pending = [(i, writer.frames_of(i)) for i in writer.pending()]
        start = time.perf_counter()

        def enter(entry: ShardEntry) -> None:
            writer.enter_shard(entry)
            on_frames(len(entry.frames))

        _render(scene, out, pending, workers, cluster, enter)
        seconds = time.perf_counter() - start
        _finish(writer, draft, film)
    rendered = sum(len(frames) for _, frames in pending)
    return Summary(out, scene.frames, rendered, seconds, _size(out), trajectory.stats)


def _side_files(scene: Scene, rig, person) -> dict[str, bytes]:
    from egocap_sim.proportions import proportions_of

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
        from egocap_sim.cluster import render_on_cluster

        render_on_cluster(cluster, scene, out, pending, enter)


def _finish(writer: SequenceWriter, draft: Truth, film: Film | None) -> None:
    """Complete the truth with what rendering found, and record it last of all."""
    sequence = _Shards(writer)
    visibility = np.stack([sequence.visibility(i) for i in range(writer.manifest.frames)])
    truth = replace(draft, visibility=visibility)
    if film is not None:
        writer.write_file(SENSOR, film.applied.content())
        film.discard(writer.folder)
    if (others := sequence.others_of(truth)) is not None:
        writer.write_file(OTHERS, others.content())
    writer.write_file("truth.npz", truth.content())
    (writer.folder / DRAFT).unlink()


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
        return others_truth(np.array(found), truth.T_world_head, Rig.from_json(self._rig_path))

    @property
    def _rig_path(self) -> Path:
        true = self.folder / TRUE_RIG
        return true if true.exists() else self.folder / "rig.json"


def _digest(config: dict) -> str:
    return hashlib.sha256(json.dumps(config, sort_keys=True).encode()).hexdigest()


def _size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.iterdir() if path.is_file())
