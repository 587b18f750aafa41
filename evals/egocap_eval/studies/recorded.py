"""Detect and track recorded motions of the validation or the test set, from images.

Each clip of the set is acted out by another person in another room, whose seeds are kept for the
set, on one rig. Its middle is rendered, detected and tracked: offline with the true proportions,
offline with proportions fitted to another clip of the same person, each also with head poses
found in the pictures, live, live with a lag, and live after a darkness. Intervals are over clips.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from tyro.conf import arg

import egocap
from egocap.body.proportions import Proportions
from egocap.data.detections import Detections, load_detections, save_detections
from egocap.data.head_pose import HeadPoses, read_head_poses
from egocap.data.sequence import Sequence as Footage
from egocap.detect.sources import detections_from
from egocap.detect.weights import open_weights
from egocap.errors import EgocapError, InputError
from egocap.evaluation.detection_scores import normalised_error
from egocap.evaluation.metrics import bootstrap_interval
from egocap.evaluation.report import Report
from egocap.evaluation.table import Table, number
from egocap.fitting.fit_body import fit_body
from egocap_eval.detection.detector import accuracy, score
from egocap_eval.harness.cases import ScoreLog, Scores, run_cases
from egocap_eval.harness.footage import prepare_sequence
from egocap_eval.harness.sources import file_hash, source_hashes
from egocap_eval.harness.study import Outcome
from egocap_eval.sets.motion_sets import motion_sets, split_clips
from egocap_eval.sets.test_log import log_look
from egocap_eval.studies.personalised import CALIBRATION_S, calibration_scene, live_joints
from egocap_eval.studies.recovery import after_darkness
from egocap_sim.scene.config import Scene

log = logging.getLogger(__name__)

SIZE = (640, 512)
FPS = 30
CALIBRATION_FPS = 10  # the fit selects frames that differ
RIG = "egorig1"
WORLD, FITTED_WORLD = "offline, head's path found", "fitted body, head's path found"
FITTED, LAGGED, DARK = "offline, fitted body", "live, 0.1 s lag", "live, after 2 s of darkness"
_LAG_S = 0.1
RATIOS = {"live": 1.6, LAGGED: 1.3}
"""Maximum error of the online tracker relative to the offline one's."""
RECOVERY_S = 0.3
"""Maximum time of recovery from darkness, in every clip."""
CODE = ("egocap", "egocap_sim", "egocap_eval/studies/recorded.py",
        "egocap_eval/studies/recovery.py")  # fmt: skip
PLACED = ("world_aligned_mpjpe_mm", "root_translation_percent", "foot_skate", "penetration_mm",
          "contact_f1")  # fmt: skip
"""Measures in the world, of tracks with head poses."""
DIGITS = {"normalised_error_visible": 2, "normalised_error_in_view": 2, "recovery_s": 2,
          "root_translation_percent": 2, "foot_skate": 3, "contact_f1": 2}  # fmt: skip
"""Decimals in tables, where they are not one."""
ODOMETRY = ("egocap/odometry", "egocap/head_pose")
POSE = ("mpjpe_mm", "visible_mm", "hidden_mm", "arms_mm", "legs_mm", "ankles_mm", "feet_mm",
        "p95_mm", "accel_error")  # fmt: skip


@dataclass(frozen=True)
class Recording:
    """A clip of the set: its footage, detections, and another clip of the same person."""

    name: str
    footage: Footage
    calibration: Footage
    source: str  # of detections
    version: str  # of the detector, in the names of the files that keep detections

    @cached_property
    def detections(self) -> Detections:
        """Detections of the clip."""
        return self._detected(self.footage)

    @cached_property
    def fitted(self) -> Proportions:
        """Proportions fitted to the calibration clip."""
        return fit_body(self._detected(self.calibration), self.calibration.rig).proportions

    @cached_property
    def heads(self) -> HeadPoses | None:
        """Head poses that the odometry finds in the pictures; None where it finds none."""
        from egocap.head_pose.from_pictures import find_head_poses

        code = "-".join(h[:8] for h in source_hashes(ODOMETRY).values())
        path = self.footage.folder.with_suffix(f".heads-{code}.npz")
        if not path.is_file():
            try:
                find_head_poses(self.footage, self.footage.rig).save(path)
            except InputError as error:
                log.warning("%s", error)
                return None
        return read_head_poses(path, self.footage.times)

    def _detected(self, footage: Footage) -> Detections:
        path = footage.folder.with_suffix(f".{self.version}.npz")
        if not path.is_file():
            save_detections(path, detections_from(footage, self.source, 0))
        return load_detections(path)


def study(
    motions: Annotated[Path, arg(metavar="DIR")],
    set: Literal["validation", "test"] = "validation",
    clips: tuple[Annotated[str, arg(metavar="NAME")], ...] = (),
    frames: int = 90,
    detections: Annotated[str, arg(metavar="SOURCE")] = "learned",
    known_body: bool = False,
    work: Annotated[Path, arg(metavar="DIR")] = Path("out/recorded"),
    workers: int = 1,
    keep: Annotated[Path | None, arg(metavar="FILE")] = None,
    reason: str | None = None,
) -> Outcome:
    """Detect and track the recorded motions of a set from images, offline and live.

    A look at the test set is logged in evals/test_log.jsonl; it requires a clean checkout and
    --reason.

    Args:
        motions: Folder of the motion clips.
        set: Set of clips.
        clips: Names of some of its clips, without suffix; all by default.
        frames: Frames of each clip, from its middle.
        detections: Source of detections: learned, or learned:FILE.
        known_body: Leave out fitted proportions and the clips that they need.
        work: Folder of the sequences and detections; made where they are missing.
        workers: Rendering processes; one is fastest for short sequences.
        keep: Finished scores; the same command continues from them after a stop.
        reason: Why the test set is looked at.
    """
    kind, _, name = detections.partition(":")
    if kind != "learned" or frames < 2:
        raise InputError(f"--detections {detections}, --frames {frames}",
                         valid="learned or learned:FILE, 2 or more")  # fmt: skip
    weights = open_weights(name or None).sha256
    seeds = clip_seeds(motions, set, clips)
    if set == "test":
        log_look(reason, weights)
    make = partial(record, folder=work / set, frames=frames, workers=workers,
                   detections=detections, fit=not known_body)  # fmt: skip
    recordings, left_out = {}, {}
    for path, seed in seeds.items():
        try:
            recordings[path.stem] = make(path, seed)
        except EgocapError as error:
            left_out[path.stem] = str(error)
    cases = {n: c for n, c in CASES.items() if not (known_body and n in (FITTED, FITTED_WORLD))}
    log = ScoreLog(keep, frames=frames, weights=weights, code=source_hashes(CODE))
    runs = run_cases(f"recorded {set}", cases, recordings, lambda case, one, _: case(one), log=log)
    rows = [{"clip": name, "frames": len(one.footage)} | {c: dict(runs[c][i][0]) for c in cases}
            for i, (name, one) in enumerate(recordings.items())]  # fmt: skip
    result = {"set": set, "rig": RIG, "size": list(SIZE), "rows": rows, "left_out": left_out,
              "mean": {case: means([row[case] for row in rows]) for case in cases}}  # fmt: skip
    config = {
        "weights": weights,
        "clips": {path.name: file_hash(path) for path in seeds},
        "sequences": {n: r.footage.manifest.config_sha256 for n, r in recordings.items()},
    }
    return Outcome(result, tables(result), missed(result), config=config)


def record(
    path: Path, seed: int, *, folder: Path, frames: int, workers: int, detections: str, fit: bool
) -> Recording:
    """Simulate and render a clip where it is missing. Raises EgocapError as `generate`."""
    scenes = scenes_of(path, seed, frames)[: 2 if fit else 1]
    footage = [prepare_sequence(scene, folder / scene.name, workers) for scene in scenes]
    version = detector_version(detections)
    return Recording(path.stem, footage[0], footage[-1], detections, version)


def detector_version(detections: str) -> str:
    """Weights and code of a learned detector, for names of files that keep detections."""
    code = source_hashes(["egocap/detect"])["egocap/detect"]
    return f"{open_weights(detections.partition(':')[2] or None).sha256[:8]}-{code[:8]}"


def clip_seeds(
    motions: Path, name: Literal["validation", "test"], clips: Sequence[str]
) -> dict[Path, int]:
    """The chosen clips of a set, and each one's seed. Raises InputError for unknown clips."""
    of_set = split_clips(motions)[name]
    known = [path.stem for path in of_set]
    unknown = [clip for clip in clips if clip not in known]
    if unknown or not known:
        raise InputError(f"no clip {', '.join(unknown)} in the {name} set", valid=known)
    seeds = {path: motion_sets().seed(name, i) for i, path in enumerate(of_set)}
    return {path: seed for path, seed in seeds.items() if not clips or path.stem in clips}


def scenes_of(path: Path, seed: int, frames: int) -> tuple[Scene, Scene]:
    """The middle frames of a clip, and a calibration clip, of the person of a seed."""
    from egocap_sim.motion.clips.load import load_clip
    from egocap_sim.world.world import World

    clip = load_clip(path)
    seconds = len(clip.positions) / clip.fps
    start = max(0.0, 0.5 * (seconds - (frames + 1) / FPS))
    scene = Scene.model_validate({
        "name": path.stem, "frames": frames, "fps": FPS, "seed": seed,
        "rig": {"name": RIG, "size": SIZE}, "place": {"name": "room", "clear_radius": 2.0},
        "motion": {"file": str(path.resolve()), "start_s": start},
    })  # fmt: skip
    frames = min(frames, World(scene).clip_frames)
    fit = calibration_scene(scene, path.stem, seed)
    sparse = {"fps": CALIBRATION_FPS, "frames": round(CALIBRATION_S * CALIBRATION_FPS)}
    return scene.model_copy(update={"frames": frames}), fit.model_copy(update=sparse)


def detector_scores(one: Recording) -> Scores:
    """PCK and AUC at 20 px and normalised error of joints that are visible and of those in view."""
    scored = score(one.footage, one.detections)
    found: dict[str, Any] = {}
    for kind, counted in (("visible", scored.seen), ("in_view", scored.in_view)):
        found[f"normalised_error_{kind}"] = normalised_error(
            scored.errors, scored.sigma, counted & scored.detected
        )
        values = accuracy(scored, counted)
        found |= {f"{name}_{kind}": values[name] for name in ("pck20", "auc20")}
        found |= {f"{group}_{kind}": value for group, value in values["groups"].items()}
    return found


def offline_scores(one: Recording) -> Scores:
    """Errors of the tracker with the true proportions."""
    return pose_scores(_offline(one, one.footage.body))


def fitted_scores(one: Recording) -> Scores:
    """Errors of the tracker with fitted proportions."""
    return pose_scores(_offline(one, one.fitted))


def world_scores(one: Recording, fitted: bool = False) -> Scores:
    """Errors, also in the world, of the tracker with head poses found in the pictures."""
    report = _offline(one, one.fitted if fitted else one.footage.body, one.heads)
    return {**pose_scores(report), **{name: getattr(report, name) for name in PLACED}}


def live_scores(one: Recording, lag: float = 0.0) -> Scores:
    """Errors of the online tracker with the true proportions, the poses late by `lag` seconds."""
    joints = live_joints(one.footage, one.detections, lag)
    return pose_scores(egocap.evaluate(joints, one.footage))


CASES: Mapping[str, Callable[[Recording], Scores]] = {
    "detector": detector_scores,
    "offline": offline_scores,
    WORLD: world_scores,
    FITTED: fitted_scores,
    FITTED_WORLD: partial(world_scores, fitted=True),
    "live": live_scores,
    LAGGED: partial(live_scores, lag=_LAG_S),
    DARK: lambda one: after_darkness(one.footage, one.detections),
}


def pose_scores(report: Report) -> Scores:
    """The measures `POSE` of a report, mm; acceleration in m/s^2."""
    joints = report.per_joint_mm
    own = {
        "arms_mm": report.upper_mm, "legs_mm": report.lower_mm,
        "ankles_mm": _both(joints, "ankle"), "feet_mm": _both(joints, "foot"),
    }  # fmt: skip
    return {name: own[name] if name in own else getattr(report, name) for name in POSE}


def means(rows: Sequence[Scores]) -> dict[str, dict[str, float] | None]:
    """Mean over clips of each measure with its bootstrap interval; None below two clips."""
    found: dict[str, dict[str, float] | None] = {}
    for name in rows[0] if rows else ():
        values = np.array([row[name] for row in rows if row[name] is not None], float)
        if len(values) < 2:
            found[name] = None
            continue
        low, high = bootstrap_interval(values, np.random.default_rng(0))
        found[name] = {"mean": float(values.mean()), "low": low, "high": high}
    return found


def missed(result: Mapping[str, Any]) -> list[str]:
    """Targets of the online tracker that are not met, in words."""
    mean, words = result["mean"], []
    offline = mean["offline"].get("mpjpe_mm")
    for case, most in RATIOS.items():
        if offline and mean[case]["mpjpe_mm"]["mean"] > most * offline["mean"]:
            ratio = mean[case]["mpjpe_mm"]["mean"] / offline["mean"]
            words.append(f"{case}: {ratio:.2f} times the offline error, not {most:g}")
    for row in result["rows"]:
        spent = row[DARK]["recovery_s"]
        if spent is not None and spent > RECOVERY_S:
            words.append(f"{row['clip']}: recovered {spent:.2f} s after darkness, "
                         f"not {RECOVERY_S:g}")  # fmt: skip
    return words


def tables(result: Mapping[str, Any]) -> list[Table]:
    """A table of the detector and one of each way to track, a row a clip."""
    detector = ("pck20_visible", "auc20_visible", "normalised_error_visible", "pck20_in_view",
                "auc20_in_view", "normalised_error_in_view", "wrist_in_view", "knee_in_view",
                "ankle_in_view", "foot_in_view")  # fmt: skip
    made = [_table(result, "detector", detector)]
    made += [_table(result, case, measures_of(case)) for case in result["mean"]
             if case != "detector"]  # fmt: skip
    if result["left_out"]:
        made.append(Table("Left out", ("clip", "reason"), tuple(result["left_out"].items())))
    return made


def measures_of(case: str) -> Sequence[str]:
    """The measures of a way to track."""
    if case == DARK:
        return "recovery_s", "after_mm", "usual_mm", "dark_mm"
    return (*POSE, *PLACED) if case in (WORLD, FITTED_WORLD) else POSE


def _table(result: Mapping[str, Any], case: str, measures: Sequence[str]) -> Table:
    digits = {m: DIGITS.get(m, 1) for m in measures}
    rows = [(row["clip"], str(row["frames"]), *(number(row[case][m], digits[m]) for m in measures))
            for row in result["rows"]]  # fmt: skip
    summary = result["mean"][case]
    rows.append(
        ("mean", "", *(number(s["mean"], digits[m]) if (s := summary.get(m)) else "-"
                       for m in measures))
    )  # fmt: skip
    rows.append(("95 % interval", "", *(
        f"{s['low']:.{digits[m]}f} to {s['high']:.{digits[m]}f}" if (s := summary.get(m)) else "-"
        for m in measures
    )))  # fmt: skip
    header = ("clip", "frames", *(m.replace("_", " ") for m in measures))
    return Table(f"{case}, {result['set']} set", header, tuple(rows))


def _offline(one: Recording, body: Proportions, heads: HeadPoses | None = None) -> Report:
    tracker = egocap.Tracker(one.footage.rig, body)
    return egocap.evaluate(tracker.track(one.detections, one.footage.images, heads), one.footage)


def _both(joints: Mapping[str, float | None], part: str) -> float | None:
    sides = [joints[f"{side}_{part}"] for side in ("left", "right")]
    return None if None in sides else float(np.mean([s for s in sides if s is not None]))
