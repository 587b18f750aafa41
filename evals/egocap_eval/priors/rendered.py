"""Tracks of rendered motions, from the shipped detector's own detections.

Every motion is acted out by two people in two rooms, on the main rig and on another. So the motion
network learns which errors this detector makes of limbs that it guesses.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from egocap.commandline import progress
from egocap.detect.sources import detections_from
from egocap.errors import EgocapError
from egocap_eval.harness.cases import map_in_processes
from egocap_eval.harness.footage import prepare_sequence
from egocap_eval.priors.takes import FPS, Take, clips_of, fit_angles
from egocap_eval.priors.tracks import SIZE, LearningTrack, kept_track, track_detections
from egocap_eval.studies.recorded import detector_version
from egocap_sim.motion.clips.load import load_clip
from egocap_sim.scene.config import Scene
from egocap_sim.world.world import World

log = logging.getLogger(__name__)

SOURCE = "learned"  # of the detections: the shipped weights


@dataclass(frozen=True)
class Recordings:
    """One recording of every motion."""

    rigs: tuple[str, ...]  # in turn
    first_seed: int  # of the people and rooms
    frames: int  # at most


RECORDINGS = (
    Recordings(("egorig1",), 330_000, 110),
    Recordings(("glasses", "headset4", "cap", "egorig2"), 332_000, 90),
)
"""Every motion is recorded so. No validation or test footage has these seeds."""


@dataclass(frozen=True)
class _Job:
    """One recording of one motion."""

    name: str
    clip: Path | None  # None: a built-in motion
    rig: str
    seed: int
    frames: int  # at most
    kept: Path | None  # the track's file


def rendered_tracks(
    folder: Path | None, built_in: Sequence[str], keep: Path | None, workers: int
) -> list[LearningTrack]:
    """Tracks of the clips of a folder that may be learned from, and of built-in motions.

    Those that the same detector left in the folder `keep` are read from there, the others written
    to it. Clips that cannot be acted out are left out with a warning. `workers` are processes.
    Clips have the first seeds, whatever the built-in motions.
    """
    motions = sorted(clips_of(folder, built_in), key=lambda motion: motion[1] is None)
    version = detector_version(SOURCE)
    jobs = [
        _Job(name, path, of.rigs[index % len(of.rigs)], of.first_seed + index, of.frames,
         keep and keep / f"{name}.{of.first_seed}.{version}.npz")
        for of in RECORDINGS
        for index, (name, path) in enumerate(motions)
    ]  # fmt: skip
    tracks = []
    with progress("rendered", len(jobs), unit="tracks") as advance:
        for track in map_in_processes(_make, jobs, workers):
            tracks.append(track)
            advance()
    return [track for track in tracks if track is not None]


def _make(job: _Job) -> LearningTrack | None:
    try:
        return kept_track(job.name, job.kept, lambda: _rendered(_scene(job)))
    except EgocapError as error:
        log.warning("%s left out: %s", job.name, error)
        return None


def _rendered(scene: Scene) -> LearningTrack:
    with TemporaryDirectory() as work:
        footage = prepare_sequence(scene, Path(work) / scene.name)
        truth, person = footage.truth, footage.body
        take = Take(
            scene.name, fit_angles(truth.joints_head, person), truth.joints_head,
            truth.T_world_head, np.asarray(person.offsets),
        )  # fmt: skip
        return track_detections(take, detections_from(footage, SOURCE, 0), footage.rig)


def _scene(job: _Job) -> Scene:
    """A clip from a random start, or a built-in motion."""
    motion: dict[str, object] = {"name": job.name.split("-")[1]}
    if job.clip is not None:
        clip = load_clip(job.clip)
        last = len(clip.positions) / clip.fps - (job.frames + 1) / FPS
        start = np.random.default_rng(job.seed).uniform(0.0, max(last, 0.0))
        motion = {"file": str(job.clip.resolve()), "start_s": start}
    scene = Scene.model_validate({
        "name": job.name, "frames": job.frames, "fps": FPS, "seed": job.seed,
        "rig": {"name": job.rig, "size": SIZE}, "place": {"name": "room", "clear_radius": 2.0},
        "motion": motion, "record": {"masks": False},
    })  # fmt: skip
    most = job.frames if job.clip is None else World(scene).clip_frames
    return scene.model_copy(update={"frames": min(job.frames, most)})
