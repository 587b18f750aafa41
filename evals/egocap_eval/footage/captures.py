"""Motion capture from camera files, against the same footage with known synchronisation.

Every case is simulated with two clocks, exported as H.264 files (`egocap-sim export --format
videos`) and captured by `egocap mocap`, a process that sees the files, the rig and the person's
height alone. The reference runs the same stages on the simulated sequence itself, with the rig that
`mocap` corrected: its images are not compressed again and its clocks are known.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from tyro.conf import arg

from egocap.cameras.rig import Rig
from egocap.cameras.rig_files import load_rig
from egocap.data.footage import FrameTimes
from egocap.data.head_pose import head_poses_at, interpolate_poses, load_head_pose
from egocap.data.sequence import Sequence, open_sequence
from egocap.data.track import Track, load_track
from egocap.detect.detector import Detector
from egocap.detect.weights import open_weights
from egocap.errors import InputError
from egocap.evaluation.pose_errors import GroundTruth, PoseErrors
from egocap.evaluation.table import Table, number
from egocap.files import read_npz
from egocap.head_pose.from_pictures import find_head_poses
from egocap.head_pose.result import HeadTrajectory
from egocap.motion_capture.body import fit_wearer
from egocap.motion_capture.tracking import track_in_windows
from egocap.pose.config import TrackerConfig
from egocap.schema import read_json
from egocap.series import interpolate, nearest
from egocap_eval.footage.process import run_egocap
from egocap_eval.footage.synchronisation import FPS, case_scene, clock_misses, clock_scores
from egocap_eval.harness.footage import content_hashes, prepare_sequence
from egocap_eval.harness.study import Outcome
from egocap_eval.sets.motion_sets import motion_sets, split_clips
from egocap_eval.sets.test_log import log_look
from egocap_eval.studies.fit_body import person_height
from egocap_eval.studies.head_pose import score
from egocap_sim.export.formats import export
from egocap_sim.export.videos import PLANTED
from egocap_sim.scene.config import RecordTable, Scene
from egocap_sim.sensor.config import SensorTable

VALIDATION = ("walk", "gesture", "signal")
"""Cases of `synchronisation` whose motion is a validation scene or clip."""
TEST_CLIPS, MOST_S = 2, 20.0  # the longest clips of the test set, and how much of each
TEST_SENSORS = (
    {"preset": "consumer", "subframes": 3, "time_offset_s": 0.0171, "clock_drift_ppm": 35.0},
    {"preset": "action-camera", "subframes": 3, "time_offset_s": -0.0093,
     "clock_drift_ppm": -45.0},
)  # fmt: skip
PATH = ("all_aligned_mm", "up_error_deg", "height_error_mm")
"""Errors of the head's path, as in the study of head poses."""
STATED = ("up_std_deg", "floor_std_mm")
"""Standard deviations of the last two, as the file states them."""
WORSE_MM, RATE, MEMORY_MB = 2.0, 20.0, 2048.0  # what is to be reached


def study(
    set: Literal["validation", "test"] = "validation",
    cases: tuple[Annotated[str, arg(metavar="NAME")], ...] = (),
    motions: Annotated[Path | None, arg(metavar="DIR")] = None,
    size: tuple[int, int] = (640, 512),
    work: Annotated[Path, arg(metavar="DIR")] = Path("out/captures"),
    workers: int = 1,
    reason: str | None = None,
) -> Outcome:
    """Capture motion from exported camera files; measure clocks, errors, time and memory.

    A look at the test set is logged in evals/test_log.jsonl; it requires a clean checkout and
    --reason.

    Args:
        set: Set of motions: three validation ones, or the two longest clips of the test set.
        cases: Some of its cases; all by default.
        motions: Folder of the motion clips.
        size: Image width and height.
        work: Folder of sequences, videos and captures; sequences are made where they are missing.
        workers: Rendering processes.
        reason: Why the test set is looked at.
    """
    scenes = _scenes(set, motions, size)
    if unknown := [name for name in cases if name not in scenes]:
        raise InputError(f"unknown case '{unknown[0]}'", valid=scenes)
    weights = open_weights(None).sha256
    if set == "test":
        log_look(reason, weights)
    found, sequences = {}, []
    for name in cases or scenes:
        sequences.append(prepare_sequence(scenes[name], work / "sequences" / name, workers))
        found[name] = measure(sequences[-1], work / "videos" / name, work / "captures" / name)
    missed = [f"{name}: {what}" for name, row in found.items() for what in _misses(row)]
    result = {"set": set, "size": list(size), "load": os.getloadavg()[0], "cases": found}
    config = {"weights": weights, **content_hashes(sequences)}
    return Outcome(result, _tables(found), missed, config=config)


def measure(sequence: Sequence, videos: Path, out: Path) -> dict[str, Any]:
    """Export a sequence, capture its motion from the files, and score both ways to track it."""
    for folder in (videos, out):
        if folder.exists():
            shutil.rmtree(folder)
    export(sequence, "videos", videos)
    height = round(person_height(sequence.folder), 2)
    planted = read_json(videos / PLANTED)["views"]
    spent = run_egocap([
        "mocap", *(str(videos / f"{view}.mp4") for view in planted), "--rig",
        str(videos / "rig.json"), "--height", str(height), "--out", str(out),
    ])  # fmt: skip
    imported, captured = open_sequence(out / "sequence"), load_track(out / "track.npz")
    assert imported.footage is not None
    times = scene_times(sequence, planted, captured.times)
    error = joint_error_mm(captured.joints_head, sequence, times)
    reference = _reference_error(
        sequence, load_rig(out / "rig.json"), height, float(times[0]), float(times[-1])
    )
    return {
        "frames": len(captured.times),
        **clock_scores(sequence, planted, imported.footage),
        "mocap_mm": error, "known_sync_mm": reference, "worse_mm": error - reference,
        **path_scores(out / "head.npz", sequence, times, captured.times),
        "wall_s": spent.wall_s, "frames_per_second": len(captured.times) / spent.wall_s,
        "cpu_ms_per_frame": 1e3 * spent.cpu_s / len(captured.times), "peak_mb": spent.peak_mb,
    }  # fmt: skip


def scene_times(
    sequence: Sequence, planted: Mapping[str, Any], own: Float[Array, "N"]
) -> Float[Array, "N"]:
    """Times of the scene at times by the clock of the first view's file."""
    first = next(iter(planted.values()))
    frame = first["frames"][0] + own * sequence.manifest.fps
    taken = sequence.times if sequence.sensor is None else sequence.sensor.time[:, 0]
    return np.interp(frame, np.arange(len(taken)), taken)


def path_scores(
    file: Path, sequence: Sequence, times: Float[Array, "N"], own: Float[Array, "N"]
) -> dict[str, float | None]:
    """Errors of the head's path, of up and of the floor's height; None where no path was found.

    `times` of the scene, and `own` by the clock of the first view's file, of the frames.
    """
    if not file.exists():
        return dict.fromkeys((*PATH, *STATED)) | {"placed": 0.0}
    known, poses = load_head_pose(file)
    inside = np.clip(times, sequence.times[0], sequence.times[-1])
    truth = interpolate_poses(inside, sequence.times, sequence.truth.T_world_head)
    scores = score(HeadTrajectory(nearest(own, known), known, poses), truth)
    stated = json.loads(str(read_npz(file)["facts"]))["vertical"]
    return {name: scores[name] for name in PATH} | {name: stated[name] for name in STATED} | {
        "placed": len(known) / len(own)}  # fmt: skip


def joint_error_mm(
    joints_head: Float[Array, "N 18 3"], sequence: Sequence, times: Float[Array, "N"]
) -> float:
    """Mean error of the 17 joints against the truth, interpolated at times of the scene."""
    true = sequence.truth.joints_head
    truth = GroundTruth(interpolate(times, sequence.times, true), times)
    errors = PoseErrors.between(joints_head, truth)
    return float(1e3 * errors.joint_errors[errors.counted].mean())


def _reference_error(
    sequence: Sequence, rig: Rig, height: float, first: float, last: float
) -> float:
    """Error of the same stages with a rig on the sequence itself, over a span of its time."""
    track = track_with_known_clocks(sequence, rig, height)
    rows = (track.times >= first) & (track.times <= last)
    return joint_error_mm(track.joints_head[rows], sequence, track.times[rows])


class WithKnownClocks(Sequence):
    """A simulated sequence that tells every picture's true time."""

    def __init__(self, simulated: Sequence) -> None:
        super().__init__(simulated.folder)
        self._taken = None if simulated.sensor is None else simulated.sensor.time
        self._frames = simulated.times

    @cached_property
    def frame_times(self) -> FrameTimes | None:
        """Pictures of every frame; None where a frame's are of one instant."""
        if self._taken is None:
            return None
        shape = self._taken.shape
        return FrameTimes(self._frames, self._taken, np.zeros(shape, int), np.ones(shape, bool))


def track_with_known_clocks(sequence: Sequence, rig: Rig, height: float) -> Track:
    """Detect, fit the body, find the head's path and track with a rig as `mocap` does."""
    timed = WithKnownClocks(sequence)
    found = Detector(sequence.rig).detect(timed)
    body = fit_wearer(found, rig, height).proportions
    path = find_head_poses(timed, rig)
    heads = replace(head_poses_at(timed.times, path.time, path.T_world_head),
                    floor_std=path.floor_std)  # fmt: skip
    return track_in_windows(sequence.folder, found, body, TrackerConfig(), heads=heads, rig=rig)


def _scenes(
    set: Literal["validation", "test"], motions: Path | None, size: tuple[int, int]
) -> dict[str, Scene]:
    """Scenes of the cases by name. Raises InputError without the motions that they need."""
    if motions is None:
        raise InputError("no --motions", valid="the folder of the motion clips")
    if set == "validation":
        found = {name: case_scene(name, size, motions) for name in VALIDATION}
        return {name: scene for name, scene in found.items() if scene is not None}
    from egocap_eval.studies.recorded import scenes_of
    from egocap_sim.motion.clips.load import load_clip

    clips = {path: motion_sets().seed("test", i)
             for i, path in enumerate(split_clips(motions)["test"])}  # fmt: skip
    seconds = {path: len(clip.positions) / clip.fps
               for path, clip in ((path, load_clip(path)) for path in clips)}  # fmt: skip
    longest = sorted(clips, key=lambda path: -seconds[path])[:TEST_CLIPS]
    return {
        path.stem: _with_two_clocks(scenes_of(path, clips[path], int(MOST_S * 30))[0], sensor, size)
        for path, sensor in zip(longest, TEST_SENSORS, strict=True)
    }


def _with_two_clocks(scene: Scene, sensor: Mapping[str, Any], size: tuple[int, int]) -> Scene:
    rig = scene.rig.model_copy(update={"size": size})
    return scene.model_copy(update={
        "fps": FPS, "frames": int(scene.frames * FPS / scene.fps) - 1, "rig": rig,
        "sensor": SensorTable(**sensor), "record": RecordTable(masks=False),
    })  # fmt: skip


def _misses(row: Mapping[str, Any]) -> list[str]:
    missed = clock_misses(row)
    if row["worse_mm"] > WORSE_MM:
        missed.append(f"{row['worse_mm']:.1f} mm worse than with known clocks ({WORSE_MM:g})")
    if row["frames_per_second"] < RATE:
        missed.append(f"{row['frames_per_second']:.1f} stereo frames/s (target {RATE:g})")
    if row["peak_mb"] > MEMORY_MB:
        missed.append(f"{row['peak_mb']:.0f} MB (target {MEMORY_MB:g})")
    return missed


def _tables(found: Mapping[str, Mapping[str, Any]]) -> list[Table]:
    clocks = tuple(
        (name, number(row["seconds"], 0), number(row["lag_error_ms"], 2),
         number(row["lag_std_ms"], 2), number(row["drift_error_ppm"], 0),
         number(row["drift_std_ppm"], 0), str(row["unreported"]), str(row["invented"]))
        for name, row in found.items()
    )  # fmt: skip
    poses = tuple(
        (name, str(row["frames"]), number(row["mocap_mm"]), number(row["known_sync_mm"]),
         number(row["worse_mm"], 2), *(number(row[name], 2) for name in (*PATH, *STATED)),
         number(row["frames_per_second"]),
         number(row["cpu_ms_per_frame"], 0), number(row["peak_mb"], 0))
        for name, row in found.items()
    )  # fmt: skip
    return [
        Table("Clock of the second view against what was planted",
              ("case", "s", "lag error ms", "+- ms", "drift error ppm", "+- ppm",
               "unreported frames", "invented"), clocks),
        Table("Motion capture from the files against known clocks",
              ("case", "frames", "mocap mm", "known clocks mm", "difference mm", "path mm",
               "up deg", "floor mm", "+- deg", "+- mm", "frames/s", "CPU ms a frame", "peak MB"),
              poses),
    ]  # fmt: skip
