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
from egocap.detect.detector import Detector
from egocap.errors import EgocapError
from egocap.workers import WorkerPool
from egocap_eval.harness.footage import prepare_sequence
from egocap_eval.priors.takes import FPS, Take, clips_of, fit_angles
from egocap_eval.priors.tracks import SIZE, LearningTrack, kept_track, track_detections
from egocap_sim.motion.clips.load import load_clip
from egocap_sim.scene.config import Scene
from egocap_sim.world.world import World

log = logging.getLogger(__name__)


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


def rendered_tracks(
    folder: Path | None, built_in: Sequence[str], keep: Path | None, workers: int
) -> list[LearningTrack]:
    """Tracks of the clips of a folder that may be learned from, and of built-in motions.

    Those in the folder `keep` are read from there, the others written to it. Clips that cannot be
    acted out are left out with a warning. `workers` are processes.
    """
    motions = sorted(clips_of(folder, built_in), key=lambda motion: motion[1] is None)
    jobs = [
        (name, path, of.rigs[index % len(of.rigs)], of.first_seed + index, of.frames,
         keep and keep / f"{name}.{of.first_seed}.npz")
        for of in RECORDINGS
        for index, (name, path) in enumerate(motions)
    ]  # fmt: skip
    tracks = []
    with WorkerPool(workers) as pool, progress("rendered", len(jobs), unit="tracks") as advance:
        for track in pool.map(_make, *zip(*jobs, strict=True)):
            tracks.append(track)
            advance()
    return [track for track in tracks if track is not None]


def _make(
    name: str, path: Path | None, rig: str, seed: int, frames: int, kept: Path | None
) -> LearningTrack | None:
    try:
        return kept_track(name, kept, lambda: _rendered(scene_of(name, path, rig, seed, frames)))
    except EgocapError as error:
        log.warning("%s left out: %s", name, error)
        return None


def _rendered(scene: Scene) -> LearningTrack:
    with TemporaryDirectory() as work:
        footage = prepare_sequence(scene, Path(work) / scene.name)
        truth, person = footage.truth, footage.body
        take = Take(
            scene.name, fit_angles(truth.joints_head, person), truth.joints_head,
            truth.T_world_head, np.asarray(person.offsets),
        )  # fmt: skip
        return track_detections(take, Detector(footage.rig).detect(footage), footage.rig)


def scene_of(name: str, path: Path | None, rig: str, seed: int, frames: int) -> Scene:
    """At most `frames` of a clip from a random start, or of a built-in motion."""
    motion: dict[str, object] = {"name": name.split("-")[1]}
    if path is not None:
        clip = load_clip(path)
        last = len(clip.positions) / clip.fps - (frames + 1) / FPS
        start = np.random.default_rng(seed).uniform(0.0, max(last, 0.0))
        motion = {"file": str(path.resolve()), "start_s": start}
    scene = Scene.model_validate({
        "name": name, "frames": frames, "fps": FPS, "seed": seed,
        "rig": {"name": rig, "size": SIZE}, "place": {"name": "room", "clear_radius": 2.0},
        "motion": motion, "record": {"masks": False},
    })  # fmt: skip
    most = frames if path is None else World(scene).clip_frames
    return scene.model_copy(update={"frames": min(frames, most)})
