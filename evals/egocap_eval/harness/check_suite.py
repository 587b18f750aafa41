"""The numbers of the regression guard: a small fixed suite of motions, conditions and one clip.

Motions are simulated and tracked from simulated detections, exact and noisy, offline and live; a
short clip is rendered. All draws have fixed seeds, so the same code gives the same numbers. A
change that only draws other noise moves them at random: a number's tolerance is three standard
errors over seeds, and at least a floor.
"""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

import egocap
from egocap.body.labels import LABELS
from egocap.body.skeleton import LIMITS
from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.data.sequence import Sequence as Footage
from egocap.data.sequence import open_sequence
from egocap.data.truth import VISIBLE
from egocap.detect.synthetic import LEARNED_LIKE
from egocap.errors import EgocapError
from egocap.evaluation import evaluate_detections
from egocap.evaluation.measures import find_measure, measure
from egocap.evaluation.pose_errors import GroundTruth, PoseErrors
from egocap.pose.config import TrackerConfig
from egocap_eval.harness.cases import Scores, run_cases
from egocap_eval.harness.footage import builtin_scene
from egocap_eval.harness.motion_truth import SimulatedMotion, draw_detections, simulate_motion
from egocap_sim.scene.config import Scene

log = logging.getLogger(__name__)

MOTIONS = (
    ("walk", "egorig1", 400901),
    ("gestures", "egorig1", 400902),
    ("dribble", "egorig2", 400903),
)
FRAMES = 120
SEEDS = 4  # of a check; a baseline's spread is taken from `SPREAD_SEEDS`
SPREAD_SEEDS = 16
CLIP_SEED, CLIP_FRAMES, CLIP_SIZE = 400904, 8, (320, 256)  # rendered
STANDARD_ERRORS = 3.0
FLOOR_SHARE = 0.02  # least relative tolerance: processors differ slightly


@dataclass(frozen=True)
class Condition:
    """Detections and tracker settings, and what is measured of the result."""

    source: str
    config: TrackerConfig
    measures: tuple[str, ...]
    noisy: bool = True  # whether seeds differ
    blind: tuple[str, ...] = ()  # labels that no view ever detects: left to the priors


_ERRORS = ("mpjpe_mm", "p95_mm", "hidden_mm", "velocity_error", "accel_error")
_BLIND = (
    *(label for label in LABELS if label.endswith(("knee", "ankle", "foot"))),
    *("right_elbow", "right_wrist", "right_hand"),
)
_FEW = ("mpjpe_mm", "p95_mm", "accel_error")
_WITHOUT_MOTION = TrackerConfig(lambda_motion=0.0)  # its prior masks the effect of the others
CONDITIONS: Mapping[str, Condition] = {
    "exact": Condition("simulated:0,occluded=keep", TrackerConfig(),
                       ("mpjpe_mm", "p95_mm", "accel_error"), noisy=False),
    "exact-live": Condition("simulated:0,occluded=keep", TrackerConfig(smoothing="none"),
                            ("mpjpe_mm", "p95_mm", "accel_error"), noisy=False),
    "blind": Condition("simulated:0", TrackerConfig(), _FEW, noisy=False, blind=_BLIND),
    "blind-posture": Condition("simulated:0", _WITHOUT_MOTION, _FEW, noisy=False, blind=_BLIND),
    "blind-plain": Condition("simulated:0", replace(_WITHOUT_MOTION, lambda_posture=0.0), _FEW,
                             noisy=False, blind=_BLIND),
    "learned-plain": Condition(LEARNED_LIKE, _WITHOUT_MOTION, _ERRORS),
    "noisy": Condition("simulated:2.0", TrackerConfig(), _ERRORS),
    "learned-like": Condition(LEARNED_LIKE, TrackerConfig(), _ERRORS),
    "live": Condition("simulated:2.0", TrackerConfig(smoothing="none"), _ERRORS),
}  # fmt: skip


@dataclass(frozen=True)
class Number:
    """One number of the suite: its value, and its tolerance to random change."""

    value: float
    tolerance: float
    better: str  # "lower", "higher", or "equal": any change is a fault
    unit: str


@dataclass(frozen=True)
class Pipeline:
    """The steps from a motion to its joints; tests replace single steps to inject faults."""

    config: Callable[[TrackerConfig], TrackerConfig] = lambda config: config
    rig: Callable[[Rig], Rig] = lambda rig: rig  # as the tracker knows it
    detections: Callable[[Detections], Detections] = lambda found: found
    joints: Callable[[Float[Array, "T 18 3"]], Float[Array, "T 18 3"]] = lambda joints: joints


def suite_config() -> dict[str, Any]:
    """What the suite's numbers depend on beside the code."""
    return {"motions": MOTIONS, "frames": FRAMES, "seeds": SEEDS, "spread_seeds": SPREAD_SEEDS,
            "sources": {name: c.source for name, c in CONDITIONS.items()}}  # fmt: skip


def measure_suite(
    pipeline: Pipeline = Pipeline(),
    *,
    seeds: int = SEEDS,
    rendered: bool = False,
    motions: Sequence[SimulatedMotion] | None = None,
    conditions: Sequence[str] = tuple(CONDITIONS),
) -> dict[str, Number]:
    """All numbers of the suite, with the tolerance that the spread over `seeds` gives.

    `motions`: motions already simulated; simulated when None. `conditions`: a subset of
    `CONDITIONS`.
    """
    motions = simulate_all() if motions is None else motions
    numbers = {name: n for motion in motions for name, n in _physics_numbers(motion)}

    def score(condition: Condition, motion: SimulatedMotion, seed: int) -> Scores:
        return _tracked(motion, condition, pipeline, seed)

    subjects = {motion.name: motion for motion in motions}
    for name in conditions:
        condition = CONDITIONS[name]
        count = seeds if condition.noisy else 1
        (runs,) = run_cases(name, {name: condition}, subjects, score, seeds=count).values()
        values = {what: np.array([[scores[what] for scores in of_seeds] for of_seeds in runs])
                  for what in runs[0][0]}  # fmt: skip
        for i, motion in enumerate(subjects):
            rows = {what: v[i] for what, v in values.items()}
            numbers |= _numbers(f"{name}/{motion}", condition, rows)
        pooled = {what: np.mean(v, axis=0) for what, v in values.items()}
        numbers |= _numbers(f"{name}/all", condition, pooled)
    if rendered:
        numbers |= rendered_numbers()
    return numbers


def simulate_all() -> list[SimulatedMotion]:
    """The suite's motions."""
    return [simulate_motion(m, frames=FRAMES, seed=seed, rig=rig) for m, rig, seed in MOTIONS]


def _tracked(
    motion: SimulatedMotion, condition: Condition, pipeline: Pipeline, seed: int
) -> dict[str, float]:
    """Each measure of a motion from one draw of its detections."""
    found = draw_detections(motion, condition.source, seed)
    found = pipeline.detections(_without(found, condition.blind))
    config = pipeline.config(condition.config)
    tracked = egocap.Tracker(pipeline.rig(motion.rig), motion.proportions, config).track(found)
    truth = GroundTruth.from_truth(motion.truth)
    scored = PoseErrors.between(pipeline.joints(tracked.joints_head), truth)
    values: dict[str, float] = {}
    for name in condition.measures:
        value = measure(scored, name)
        assert value is not None, (motion.name, name)
        values[name] = value
    return values | {"beyond_limits_deg": _beyond_limits(tracked.angles)}


def _without(found: Detections, labels: Sequence[str]) -> Detections:
    """Detections of all labels but these."""
    kept = found.valid & ~np.isin(LABELS, labels)
    return replace(found, valid=kept, confidence=np.where(kept, found.confidence, 0.0))


def _beyond_limits(angles: Float[Array, "T 37"]) -> float:
    """Mean over frames of the summed degrees beyond the anatomical limits."""
    low, high = LIMITS.T
    beyond = np.maximum(low - angles, 0) + np.maximum(angles - high, 0)
    return float(np.rad2deg(beyond.sum(-1).mean()))


def _numbers(
    prefix: str, condition: Condition, values: Mapping[str, Float[Array, "N"]]
) -> dict[str, Number]:
    found = {}
    for name, of_seeds in values.items():
        known = None if name == "beyond_limits_deg" else find_measure(name)
        unit, better = ("deg", "lower") if known is None else (known.unit, known.better)
        mean = float(of_seeds[:SEEDS].mean())
        spread = float(of_seeds.std(ddof=1)) / np.sqrt(SEEDS) if len(of_seeds) > 1 else 0.0
        least = FLOOR_SHARE * abs(mean) + (0.02 if known is None else 1e-6)
        tolerance = max(STANDARD_ERRORS * spread, least)
        found[f"{prefix}/{name}"] = Number(mean, tolerance, better, unit)
    return found


def _physics_numbers(motion: SimulatedMotion) -> Iterator[tuple[str, Number]]:
    error, speed = motion.joint_error_cm, motion.planted_foot_speed_cm_s
    yield f"physics/{motion.name}/joint_error", Number(error, 0.05 + 0.1 * error, "lower", "cm")
    yield f"physics/{motion.name}/foot_speed", Number(speed, 0.2 + 0.1 * speed, "lower", "cm/s")
    for v, view in enumerate(motion.rig.views):
        pixels, valid = motion.rig.project(motion.proportions.rest_joints)
        for axis, name in enumerate("uv"):
            mean = float(pixels[v][valid[v]][:, axis].mean())
            yield f"rig/{motion.rig.name}/{view}/{name}", Number(mean, 0.05, "equal", "px")


def rendered_numbers() -> dict[str, Number]:
    """Render the clip and compare its images, labels and depths with its truth.

    Raises MachineError where there is no OpenGL.
    """
    from egocap_sim.record.recorder import generate
    from egocap_sim.verification.crosscheck import check_pixels

    with tempfile.TemporaryDirectory() as folder:
        generate(_clip(), Path(folder) / "clip", workers=1)
        sequence = open_sequence(Path(folder) / "clip")
        pixels = check_pixels(sequence)
        visible = 100 * float((sequence.truth.visibility == VISIBLE).mean())
        light = np.mean([[image.mean() for image in frame.images] for frame in sequence])
        contrast = np.mean([[image.std() for image in frame.images] for frame in sequence])
        detector = _detector_numbers(sequence)
    return detector | {
        "rendered/labelled": Number(100 * pixels.labelled_share, 1.0, "higher", "%"),
        "rendered/in_depth": Number(100 * pixels.depth_share, 1.0, "higher", "%"),
        "rendered/visible": Number(visible, 1.0, "equal", "%"),
        "rendered/light": Number(float(light), 1.0, "equal", "of 255"),
        "rendered/contrast": Number(float(contrast), 1.0, "equal", "of 255"),
    }


def _detector_numbers(sequence: Footage) -> dict[str, Number]:
    """Scores of the shipped detector on the clip; none where its weights are missing."""
    from egocap.detect.detector import Detector
    from egocap.detect.weights import open_weights

    try:
        weights = open_weights()
    except EgocapError as error:
        log.info("the detector is left out: %s", error)
        return {}
    found = Detector(sequence.rig, weights, "onnxruntime").detect(sequence)  # same on every machine
    truth = sequence.truth
    seen = truth.visibility == VISIBLE
    widths = np.array([mount.camera.width for mount in sequence.rig.mounts], float)
    score = evaluate_detections(
        found.points, found.valid, truth.joints_2d, truth.in_view, seen, widths
    )
    values = {"pck20": score.pck20_seen, "auc20": score.auc20_seen}
    return {
        f"detector/{name}": Number(value, 1.0, "higher", "%")
        for name, value in values.items()
        if value is not None
    }


def _clip() -> Scene:
    scene = builtin_scene("validation-walk").model_dump()
    scene |= {"name": "check", "frames": CLIP_FRAMES, "seed": CLIP_SEED}
    scene["rig"]["size"] = CLIP_SIZE
    scene["record"] |= {"depth": True, "masks": True, "shard_frames": CLIP_FRAMES}
    return Scene.model_validate(scene)
