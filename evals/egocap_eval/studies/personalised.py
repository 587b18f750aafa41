"""Track with a body fitted to another clip of the same person; measure both errors.

Every person is recorded twice: squatting and gesturing, for the fit, and in another motion, which
is tracked. The fit is scored per bone; the track by its joint errors with the fitted body, with the
true proportions and with those of an average adult. The people have development seeds, or are the
validation ones of the paper's scenes.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

import egocap
from egocap.body.proportions import Proportions
from egocap.data.detections import Detections
from egocap.data.sequence import Sequence
from egocap.detect.sources import detections_from
from egocap.errors import InputError
from egocap.evaluation.table import Table, number
from egocap.fitting.body_prior import BodyPrior, to_proportions
from egocap.fitting.fit_body import BodyFit, fit_body
from egocap.pose.config import TrackerConfig
from egocap_eval.harness.cases import Scores, mean, run_cases
from egocap_eval.harness.footage import builtin_scene, content_hashes, prepare_sequence
from egocap_eval.harness.study import Outcome
from egocap_eval.studies.fit_body import bone_errors, person_height, summary, summary_table
from egocap_sim.scene.config import Scene

SIZE = (640, 512)
FPS = 30
CALIBRATION = ("squat", "gestures")
CALIBRATION_S = 12.0
SCENES = ("validation-walk", "validation-gesture")
TARGET_PERCENT = 3.0  # of a well determined bone
TARGETS_MM = {"validation-walk": {"mpjpe_mm": 30.0},
              "validation-gesture": {"upper_mm": 20.0, "lower_mm": 30.0}}  # fmt: skip
"""Maximum errors of the people of the validation scenes with the fitted body."""
LIVE = "true, live"
BODIES = ("fitted", "true", "average", LIVE)
"""Proportions that a clip is tracked with: offline, and the true ones live too."""


@dataclass(frozen=True)
class Case:
    """A clip to fit a body to, and clips of the same person to track."""

    name: str
    calibration: Scene
    clips: tuple[Scene, ...]


def study(
    folder: Path,
    people: int = 6,
    first_seed: int = 400100,
    frames: int = 150,
    validation: bool = False,
    detections: str = "learned",
    height: bool = False,
    workers: int = 1,
) -> Outcome:
    """Fit a body to one clip of a person, then track other clips of the same person.

    Args:
        folder: Folder of the sequences; made where they are missing.
        people: Number of people, with seeds from the first one.
        first_seed: Seed of the first person, 400000 to 409999.
        frames: Frames of each clip that is tracked.
        validation: Use the people, frames and motions of validation-walk and validation-gesture
            instead; exit code 3 when a target is missed.
        detections: Source of detections, as for `egocap track`.
        height: Give the fit each person's height.
        workers: Rendering processes.
    """
    if not validation and not 400_000 <= first_seed <= 410_000 - people:
        raise InputError(f"people of seeds from {first_seed}", valid="400000 to 409999")
    cases = validation_cases() if validation else development_cases(people, first_seed, frames)
    bones, clips = {}, {}
    for case in cases:
        sequence = _recorded(case.calibration, folder, workers)
        stature = person_height(folder / case.calibration.name) if height else None
        fit = fit_body(detections_from(sequence, detections, 0), sequence.rig, stature)
        bones[case.name] = bone_errors(fit, sequence.body.bone_lengths)
        clips |= {clip.name: (_recorded(clip, folder, workers), fit) for clip in case.clips}

    def score(body: str, clip: tuple[Sequence, BodyFit], _: int) -> Scores:
        return errors_with(body, *clip, detections)

    runs = run_cases("bodies", {body: body for body in BODIES}, clips, score)
    rows = [{"sequence": sequence.manifest.name, "body": body, "frames": len(sequence)}
            | dict(runs[body][i][0])
            for i, (sequence, _) in enumerate(clips.values()) for body in BODIES]  # fmt: skip
    result = {
        "people": len(bones), "calibration_s": CALIBRATION_S, "detections": detections,
        "fit": summary(bones), "bones": bones, "rows": rows, "mean": _means(rows),
    }  # fmt: skip
    missed = _missed(bones, rows) if validation else []
    return Outcome(result, (summary_table(result["fit"]), _table(rows)), missed,
                   content_hashes(sequence for sequence, _ in clips.values()))  # fmt: skip


def development_cases(people: int, first_seed: int, frames: int) -> list[Case]:
    """People of development seeds, tracked walking and gesturing."""
    base = builtin_scene("validation-walk", SIZE)
    cases = []
    for seed in range(first_seed, first_seed + people):
        changes = {"seed": seed, "frames": frames}
        clips = tuple(
            _changed(base, f"person-{seed}-{motion}", motion, changes)
            for motion in ("walk", "gestures")
        )
        cases.append(Case(f"person-{seed}", calibration_scene(base, f"person-{seed}", seed), clips))
    return cases


def validation_cases() -> list[Case]:
    """The people of the paper's validation scenes, tracked in the scenes' own motions."""
    cases = []
    for name in SCENES:
        scene = builtin_scene(name, SIZE)
        cases.append(Case(name, calibration_scene(scene, name, scene.seed), (scene,)))
    return cases


def calibration_scene(like: Scene, name: str, seed: int) -> Scene:
    """A clip for fitting the body of the person of a seed: squatting and gesturing."""
    changes = {"seed": seed, "frames": round(CALIBRATION_S * FPS)}
    scene = _changed(like, f"{name}-calibration", "sequence", changes)
    motion = type(scene.motion)(name="sequence", parameters={"parts": CALIBRATION})
    return scene.model_copy(update={"motion": motion})


def _changed(like: Scene, name: str, motion: str, changes: dict[str, Any]) -> Scene:
    own = {"name": name, "motion": type(like.motion)(name=motion)}
    return like.model_copy(update=changes | own)


def _recorded(scene: Scene, folder: Path, workers: int) -> Sequence:
    return prepare_sequence(scene, folder / scene.name, workers)


def errors_with(body: str, sequence: Sequence, fit: BodyFit, detections: str) -> Scores:
    """Errors of a clip that is tracked with one of `BODIES`, mm."""
    bodies: dict[str, Proportions] = {
        "fitted": fit.proportions, "true": sequence.body,
        "average": to_proportions(BodyPrior.for_height(None).mean),
    }  # fmt: skip
    found = detections_from(sequence, detections, 0)
    if body == LIVE:
        report = egocap.evaluate(live_joints(sequence, found), sequence)
    else:
        tracked = egocap.Tracker(sequence.rig, bodies[body]).track(found, sequence.images)
        report = egocap.evaluate(tracked, sequence)
    errors = {
        "mpjpe_mm": report.mpjpe_mm, "upper_mm": report.upper_mm,
        "lower_mm": report.lower_mm, "seen_mm": report.visible_mm,
    }  # fmt: skip
    return {key: None if e is None else round(e, 2) for key, e in errors.items()}


def live_joints(sequence: Sequence, found: Detections, lag: float = 0.0) -> Float[Array, "T 18 3"]:
    """Joints in the head frame by the online tracker with the true proportions."""
    tracker = egocap.OnlineTracker(
        sequence.rig, sequence.body, TrackerConfig(smoothing="fixed-lag", lag=lag)
    )
    given = [pose for t in range(len(found.times)) for pose in tracker.step(found[t : t + 1])]
    return np.array([pose.joints_head for pose in [*given, *tracker.finish()]])


def _means(rows: list[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Over all clips, by body."""
    keys = ("mpjpe_mm", "upper_mm", "lower_mm", "seen_mm")
    own = {body: [row for row in rows if row["body"] == body] for body in BODIES}
    return {body: {key: round(float(mean([row[key] for row in own[body]]) or 0.0), 2)
                   for key in keys} for body in BODIES}  # fmt: skip


def _missed(bones: dict[str, dict[str, dict[str, Any]]], rows: list[dict[str, Any]]) -> list[str]:
    missed = []
    for person, lines in bones.items():
        for bone, line in lines.items():
            error = abs(line["error_percent"])
            if line["determined"] == "well" and not error <= TARGET_PERCENT:
                missed.append(f"{person}, {bone}: {error:.1f} %, not {TARGET_PERCENT:g}")
    for row in rows:
        limits = TARGETS_MM.get(row["sequence"], {}) if row["body"] == "fitted" else {}
        missed += [
            f"{row['sequence']}, {key}: {row[key]:.1f}, not {most:g}"
            for key, most in limits.items()
            if not row[key] <= most
        ]
    return missed


def _table(rows: list[dict[str, Any]]) -> Table:
    header = ("sequence", "body", "frames", "MPJPE mm", "upper", "lower", "seen")
    lines = tuple(
        (r["sequence"], r["body"], str(r["frames"]), number(r["mpjpe_mm"]), number(r["upper_mm"]),
         number(r["lower_mm"]), number(r["seen_mm"]))
        for r in rows
    )  # fmt: skip
    return Table("egocap-17, by the body that was tracked", header, lines)
