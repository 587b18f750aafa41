"""The guard against regressions: a small fixed suite against a committed baseline.

Motions are simulated and tracked from simulated detections, exact and noisy, offline and live; a
short clip is rendered. All draws have fixed seeds, so the same code gives the same numbers; a
change that merely draws other noise moves them by chance. The tolerance of a number is three
standard errors of that chance, measured when the baseline is recorded, and never under a floor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from tyro.conf import arg

from egocap.body.labels import LABELS
from egocap.body.skeleton import LIMITS
from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.detect.synthetic import LEARNED_LIKE
from egocap.evaluation.ground_truth import Reference
from egocap.evaluation.measures import find_measure, measure
from egocap.evaluation.pose import beside_truth
from egocap.evaluation.table import Table
from egocap.pose.config import TrackerConfig
from egocap_eval.harness.motion_truth import Performance, draw_detections, perform_motion
from egocap_eval.harness.result_file import load_result, save_result
from egocap_eval.harness.study import Outcome

COMMITTED = Path(__file__).parents[1] / "baselines" / "ci.json"
MOTIONS = (
    ("walk", "egorig1", 400901),
    ("gestures", "egorig1", 400902),
    ("dribble", "egorig2", 400903),
)
FRAMES = 120
SEEDS = 4  # of a check; a baseline's spread is taken from `SPREAD_SEEDS`
SPREAD_SEEDS = 16
STANDARD_ERRORS = 3.0
FLOOR_SHARE = 0.02  # of a value, below which no change counts: other processors differ a little


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
_WITHOUT_MOTION = TrackerConfig(lambda_motion=0.0)  # its prior hides what the others do
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
    """One number of the suite: its value, and by how much chance moves it."""

    value: float
    tolerance: float
    better: str  # "lower", "higher", or "equal": any change is a fault
    unit: str


@dataclass(frozen=True)
class Pipeline:
    """The steps from a motion to its joints, replaceable one by one to see that faults show."""

    config: Callable[[TrackerConfig], TrackerConfig] = lambda config: config
    rig: Callable[[Rig], Rig] = lambda rig: rig  # as the tracker knows it
    detections: Callable[[Detections], Detections] = lambda found: found
    joints: Callable[[Float[Array, "T 18 3"]], Float[Array, "T 18 3"]] = lambda joints: joints


@dataclass(frozen=True)
class Comparison:
    """A number of the suite beside the baseline's."""

    name: str
    baseline: Number | None
    now: float | None

    @property
    def verdict(self) -> str:
        """ "worse", "better", "same", "new" (not in the baseline) or "gone"."""
        if self.baseline is None:
            return "new"
        if self.now is None:
            return "gone"
        change = self.now - self.baseline.value
        if abs(change) <= self.baseline.tolerance:
            return "same"
        if self.baseline.better == "equal":
            return "worse"
        return "better" if (change < 0) == (self.baseline.better == "lower") else "worse"


def study(
    baseline: Annotated[Path | None, arg(metavar="FILE")] = None,
    record: bool = False,
    rendered: bool = True,
) -> Outcome:
    """Run the fixed small suite; exit code 3 with a table of what got worse than the baseline.

    Args:
        baseline: The numbers to compare with; the committed ones by default.
        record: Measure them, with their spread over seeds, and write them there instead.
        rendered: Also render a short clip, which needs OpenGL, and run the detector on it.
    """
    command = "egocap-eval check --record"
    if baseline is None:
        baseline = COMMITTED
    else:
        command += f" --baseline {baseline}"
    if record:
        numbers = measure_suite(seeds=SPREAD_SEEDS, rendered=rendered)
        content = {"numbers": {name: vars(n) for name, n in numbers.items()}}
        save_result(baseline, content, command, config=suite_config())
        return Outcome({"recorded": len(numbers)}, [numbers_table(numbers)])
    known = load_baseline(baseline)
    if not rendered:
        drawn = ("rendered/", "detector/")
        known = {name: n for name, n in known.items() if not name.startswith(drawn)}
    now = measure_suite(seeds=SEEDS, rendered=rendered)
    compared = compare_numbers(known, {name: n.value for name, n in now.items()})
    bad = [c for c in compared if c.verdict in ("worse", "gone")]
    return Outcome(
        {"numbers": {c.name: {"now": c.now, "verdict": c.verdict} for c in compared}},
        comparison_tables(compared),
        [f"{c.name}: {c.verdict}" for c in bad],
        suite_config(),
    )


def suite_config() -> dict[str, Any]:
    """What the suite's numbers depend on beside the code."""
    return {"motions": MOTIONS, "frames": FRAMES, "seeds": SEEDS, "spread_seeds": SPREAD_SEEDS,
            "sources": {name: c.source for name, c in CONDITIONS.items()}}  # fmt: skip


def measure_suite(
    pipeline: Pipeline = Pipeline(),
    *,
    seeds: int = SEEDS,
    rendered: bool = False,
    motions: Sequence[Performance] | None = None,
    conditions: Sequence[str] = tuple(CONDITIONS),
) -> dict[str, Number]:
    """All numbers of the suite, with the tolerance that the spread over `seeds` gives.

    `motions`: performances made before, to be tracked again; made afresh when None. `conditions`:
    only these of `CONDITIONS`.
    """
    motions = perform_all() if motions is None else motions
    numbers = {name: n for motion in motions for name, n in _physics_numbers(motion)}
    for name in conditions:
        condition = CONDITIONS[name]
        count = seeds if condition.noisy else 1
        per_motion = {m.name: _tracked(m, condition, pipeline, count) for m in motions}
        for motion, values in per_motion.items():
            numbers |= _numbers(f"{name}/{motion}", condition, values)
        pooled = {what: np.mean([v[what] for v in per_motion.values()], axis=0)
                  for what in next(iter(per_motion.values()))}  # fmt: skip
        numbers |= _numbers(f"{name}/all", condition, pooled)
    if rendered:
        from egocap_eval.harness.check_rendered import rendered_numbers

        numbers |= rendered_numbers()
    return numbers


def perform_all() -> list[Performance]:
    """The suite's motions."""
    return [perform_motion(m, frames=FRAMES, seed=seed, rig=rig) for m, rig, seed in MOTIONS]


def load_baseline(path: Path) -> dict[str, Number]:
    """The numbers of a baseline. Raises FileError when it is none."""
    from egocap.errors import FileError

    result = load_result(path)["result"]
    try:
        return {name: Number(**number) for name, number in result["numbers"].items()}
    except (KeyError, TypeError, AttributeError):
        raise FileError(path, "not a baseline", valid="a file written with --record") from None


def compare_numbers(baseline: Mapping[str, Number], now: Mapping[str, float]) -> list[Comparison]:
    """Every number of either, in the order of the run."""
    return [Comparison(name, baseline.get(name), now.get(name)) for name in {**now, **baseline}]


def comparison_tables(compared: Sequence[Comparison]) -> list[Table]:
    """What got worse, what got better, and how many stayed."""
    tables = []
    for title, verdicts in (("Worse than the baseline", ("worse", "gone")),
                            ("Better than the baseline (record it again)", ("better",)),
                            ("Not in the baseline (record it again)", ("new",))):  # fmt: skip
        rows = tuple(_row(c) for c in compared if c.verdict in verdicts)
        if rows:
            header = ("number", "baseline", "now", "tolerance", "unit")
            tables.append(Table(title, header, rows))
    same = sum(c.verdict == "same" for c in compared)
    return [*tables, Table("", ("numbers", "within tolerance"), ((str(len(compared)), str(same)),))]


def numbers_table(numbers: Mapping[str, Number]) -> Table:
    """All numbers with their tolerances."""
    rows = tuple((name, f"{n.value:.4g}", f"{n.tolerance:.2g}", n.unit)
                 for name, n in numbers.items())  # fmt: skip
    return Table("The suite", ("number", "value", "tolerance", "unit"), rows)


def _row(compared: Comparison) -> tuple[str, ...]:
    known = compared.baseline
    now = "-" if compared.now is None else f"{compared.now:.4g}"
    if known is None:
        return compared.name, "-", now, "-", ""
    return compared.name, f"{known.value:.4g}", now, f"{known.tolerance:.2g}", known.unit


def _tracked(
    motion: Performance, condition: Condition, pipeline: Pipeline, seeds: int
) -> dict[str, Float[Array, "N"]]:
    """Each measure for each seed."""
    from egocap.track.tracker import track

    values: dict[str, list[float]] = {}
    for seed in range(seeds):
        found = draw_detections(motion, condition.source, seed)
        found = pipeline.detections(_without(found, condition.blind))
        tracked = track(found, pipeline.rig(motion.rig), motion.proportions,
                        pipeline.config(condition.config))  # fmt: skip
        scored = beside_truth(pipeline.joints(tracked.joints_head), Reference.of(motion.truth))
        for name in condition.measures:
            value = measure(scored, name)
            assert value is not None, (motion.name, name)
            values.setdefault(name, []).append(value)
        values.setdefault("beyond_limits_deg", []).append(_beyond_limits(tracked.angles))
    return {name: np.array(v) for name, v in values.items()}


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


def _physics_numbers(motion: Performance) -> Iterator[tuple[str, Number]]:
    error, speed = motion.joint_error_cm, motion.planted_foot_speed_cm_s
    yield f"physics/{motion.name}/joint_error", Number(error, 0.05 + 0.1 * error, "lower", "cm")
    yield f"physics/{motion.name}/foot_speed", Number(speed, 0.2 + 0.1 * speed, "lower", "cm/s")
    for v, view in enumerate(motion.rig.views):
        pixels, valid = motion.rig.project(motion.proportions.rest_joints)
        for axis, name in enumerate("uv"):
            mean = float(pixels[v][valid[v]][:, axis].mean())
            yield f"rig/{motion.rig.name}/{view}/{name}", Number(mean, 0.05, "equal", "px")
