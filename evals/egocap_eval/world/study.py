"""Motion in the world: drift, sliding and sinking feet, and contacts, with given head poses.

Recorded validation clips and scenes (stairs, a bicycle, sitting) are rendered, detected and
tracked; a long walk is simulated without pictures. Each is tracked with the true head poses: moved
into the world only, with contacts, and with contacts and the errors of structure from motion; the
last is then followed by a simulated body (`egocap-sim refine`). No validation clip runs: a training
clip, acted out by another person, stands for it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.spatial.transform import Rotation
from tyro.conf import arg

from egocap.body.proportions import Proportions
from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.data.head_pose import HeadPoses
from egocap.data.track import CONTACTS
from egocap.data.truth import Truth
from egocap.detect.synthetic import LEARNED_LIKE
from egocap.errors import FileError, InputError
from egocap.evaluation.pose_errors import GroundTruth
from egocap.evaluation.scoring import evaluate_pose, world_prediction
from egocap.evaluation.table import Table, number
from egocap.pose.config import TrackerConfig
from egocap.track.colour_refinement import Images
from egocap.track.tracker import Tracker
from egocap_eval.harness.cases import ScoreLog, Scores, run_cases
from egocap_eval.harness.footage import builtin_scene, prepare_sequence
from egocap_eval.harness.motion_truth import draw_detections, simulate_motion
from egocap_eval.harness.sources import source_hashes
from egocap_eval.harness.study import Outcome
from egocap_eval.sets.motion_sets import motion_sets, split_clips
from egocap_eval.studies.recorded import Recording, clip_seeds, detector_version, scenes_of
from egocap_sim.refinement.refine import Refinement, refine
from egocap_sim.refinement.report import summary

SCENES = {"validation-walk": 120, "stairs": 180, "bike": 90, "vr": 150}
"""Built-in scenes and their numbers of frames."""
CLIPS = ("007_05", "007_07", "walking_4", "walking_48", "basketball_signal_3")
RUNNING, RUNNER = "running_4", 90
"""A training clip, and the person who acts it out."""
DETECTOR = "learned"
SIZE, CLIP_FRAMES, FPS, LONG_SEED = (640, 512), 90, 30, 460
CODE = ("egocap", "egocap_sim", "egocap_eval/world/study.py")
TURN, SHIFT, CORRELATION_S = np.deg2rad(0.27) / 3**0.5, 0.0044 / 3**0.5, 0.5
"""Head pose errors along an axis, rad and m, as of structure from motion from stereo fisheye."""
MEASURES = (
    "mpjpe_mm", "hidden_mm", "lower_mm", "world_mpjpe_mm", "world_aligned_mpjpe_mm",
    "root_translation_percent", "foot_skate", "penetration_mm", "contact_f1",
    "world_accel_error",
)  # fmt: skip
FLOOR_STD = 0.003
"""Standard deviation of the floor's height in the head poses, m, as odometry states it."""
TARGETS = {"foot_skate": 0.03, "penetration_mm": 5.0, "root_translation_percent": 0.5}
"""Largest values with contacts and true head poses."""
LEAST_F1 = 0.90


@dataclass(frozen=True, eq=False)
class Subject:
    """A recording: what the tracker is given, and the truth."""

    rig: Rig
    body: Proportions
    detections: Detections
    images: Images | None
    truth: Truth


@dataclass(frozen=True)
class Case:
    """How a recording is tracked."""

    contacts: bool
    noise: bool = False  # on the head poses
    refined: bool = False  # followed by a simulated body


CASES: Mapping[str, Case] = {
    "placed": Case(contacts=False),
    "contacts": Case(contacts=True),
    "contacts, noisy head": Case(contacts=True, noise=True),
    "noisy head, refined": Case(contacts=True, noise=True, refined=True),
}


def study(
    motions: Annotated[Path, arg(metavar="DIR")],
    work: Annotated[Path, arg(metavar="DIR")] = Path("out/world"),
    long_s: float = 60.0,
    subjects: tuple[Annotated[str, arg(metavar="NAME")], ...] = (),
    keep: Annotated[Path | None, arg(metavar="FILE")] = None,
) -> Outcome:
    """Track walks, stairs, cycling, sitting and running in the world; exit code 3: a target missed.

    Args:
        motions: Folder of the motion clips.
        work: Folder of the sequences and detections; made where they are missing.
        long_s: Length of the long walk, seconds.
        subjects: Names of some recordings; all by default.
        keep: Finished scores; the same command continues from them after a stop.
    """
    known = {**{n: _scene_maker(n) for n in SCENES}, **{n: _clip_maker(n) for n in CLIPS},
             RUNNING: _clip_maker(RUNNING), "long walk": _long_walk}  # fmt: skip
    if unknown := [name for name in subjects if name not in known]:
        raise InputError(f"no recording '{unknown[0]}'", valid=known)
    if not 2.0 <= long_s <= 600.0:
        raise InputError(f"a walk of {long_s:g} s", valid="2 to 600")
    chosen = [name for name in known if not subjects or name in subjects]
    made = {name: known[name](motions, work, long_s) for name in chosen}
    log = ScoreLog(keep, code=source_hashes(CODE), long_s=long_s)
    runs = run_cases("world", CASES, made, lambda case, one, _: score(case, one), log=log)
    rows = [{"recording": name, "frames": len(made[name].truth.time)}
            | {case: dict(runs[case][i][0]) for case in CASES}
            for i, name in enumerate(chosen)]  # fmt: skip
    return Outcome({"rows": rows}, [_table(case, rows) for case in CASES], missed(rows))


def score(case: Case, one: Subject) -> Scores:
    """All measures of a recording tracked in a way."""
    poses = one.truth.T_world_head
    if case.noise:
        poses = disturbed(poses, one.truth.time, np.random.default_rng(0))
    heads = HeadPoses(poses, np.ones(len(poses), bool), FLOOR_STD)
    tracker = Tracker(one.rig, one.body, TrackerConfig(contacts=case.contacts))
    track = tracker.track(one.detections, one.images, heads)
    changes: Scores = {}
    if case.refined:
        refinement = refine(track)
        track = refinement.track
        changes = {**summary(refinement), "force_error": force_error(refinement, one.truth)}
    report = evaluate_pose(
        track.joints_head, GroundTruth.from_truth(one.truth), world=world_prediction(track)
    )
    return {name: getattr(report, name) for name in MEASURES} | changes


def force_error(found: Refinement, truth: Truth) -> float | None:
    """Upward force on each foot against the simulated one: rms difference, body weights.

    Over refined frames whose contacts the simulation knows.
    """
    frames = found.refined & ~truth.propped
    if not frames.any():
        return None
    refined, simulated = foot_forces(found, truth)
    return float(np.sqrt(np.mean((refined - simulated)[frames] ** 2)))


def foot_forces(found: Refinement, truth: Truth) -> tuple[Float[Array, "T 2"], Float[Array, "T 2"]]:
    """Upward force on the left and right foot, refined and simulated, each in its body's weight."""
    feet = found.support[:, : len(CONTACTS), 2].reshape(-1, 2, 2).sum(2)
    weight = (truth.ground_force.sum(1) + truth.root_wrench[:, :3])[:, 2].mean()
    return feet / found.weight, truth.ground_force[..., 2] / weight


def disturbed(
    T_world_head: Float[Array, "T 4 4"], times: Float[Array, "T"], rng: np.random.Generator
) -> Float[Array, "T 4 4"]:
    """Head poses with a stationary error of `TURN` and `SHIFT`, correlated over time."""
    keep = np.exp(-np.diff(times) / CORRELATION_S)
    error = rng.normal(size=(len(times), 6))
    for t, k in enumerate(keep):
        error[t + 1] = k * error[t] + np.sqrt(1.0 - k**2) * error[t + 1]
    found = T_world_head.copy()
    turn = Rotation.from_rotvec(TURN * error[:, :3]).as_matrix()
    found[:, :3, :3] = T_world_head[:, :3, :3] @ turn
    found[:, :3, 3] += SHIFT * error[:, 3:]
    return found


def missed(rows: list[dict[str, Any]]) -> list[str]:
    """Targets that are not met with contacts and true head poses, in words."""
    found = []
    for row in rows:
        scores = row["contacts"]
        for name, largest in TARGETS.items():
            if scores[name] is not None and scores[name] > largest:
                found.append(f"{row['recording']}: {name} {scores[name]:.3g}, at most {largest:g}")
        if scores["contact_f1"] is not None and scores["contact_f1"] < LEAST_F1:
            found.append(f"{row['recording']}: contact_f1 {scores['contact_f1']:.2f}, "
                         f"at least {LEAST_F1}")  # fmt: skip
    return found


def _scene_maker(name: str) -> Callable[[Path, Path, float], Subject]:
    def make(motions: Path, work: Path, long_s: float) -> Subject:
        return _rendered(builtin_scene(name, SIZE, frames=SCENES[name]), work / name)

    return make


def _clip_maker(name: str) -> Callable[[Path, Path, float], Subject]:
    def make(motions: Path, work: Path, long_s: float) -> Subject:
        if name == RUNNING:
            paths = [p for p in split_clips(motions)["training"] if p.stem == name]
            if not paths:
                raise FileError(motions, f"no clip {name}", valid="the folder of motion clips")
            path, seed = paths[0], motion_sets().seed("validation", RUNNER)
        else:
            ((path, seed),) = clip_seeds(motions, "validation", [name]).items()
        return _rendered(scenes_of(path, seed, CLIP_FRAMES)[0], work / name)

    return make


def _rendered(scene: Any, folder: Path) -> Subject:
    footage = prepare_sequence(scene, folder)
    one = Recording(scene.name, footage, footage, DETECTOR, detector_version(DETECTOR))
    return Subject(footage.rig, footage.body, one.detections, footage.images, footage.truth)


def _long_walk(motions: Path, work: Path, long_s: float) -> Subject:
    walk = simulate_motion("walk", frames=round(long_s * FPS), seed=LONG_SEED,
                           parameters={"radius": 4.0, "speed": 1.2})  # fmt: skip
    found = draw_detections(walk, LEARNED_LIKE, LONG_SEED)
    return Subject(walk.rig, walk.proportions, found, None, walk.truth)


def _table(case: str, rows: list[dict[str, Any]]) -> Table:
    body = tuple(
        (row["recording"], str(row["frames"]),
         *(number(row[case][name], _digits(name)) for name in MEASURES))
        for row in rows
    )  # fmt: skip
    header = ("recording", "frames", *(m.replace("_", " ") for m in MEASURES))
    return Table(case, header, body)


def _digits(measure: str) -> int:
    return {"foot_skate": 3, "contact_f1": 2, "root_translation_percent": 2}.get(measure, 1)
