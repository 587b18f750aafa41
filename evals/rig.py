"""What a rig can know: visibility and Cramer-Rao bounds of stereo rigs over a suite of motions.

Motions are simulated, not rendered: joints of the simulated person, angles of the tracker's
skeleton fitted to them, occlusion by the volumetric body. A candidate's bound is the Bayesian one
of a frame alone: detections of one noise at one image size, wherever a joint is in view and not
hidden, and the posture prior. For chosen candidates the tracker runs on detections simulated with
that visibility, next to the bound given the whole motion and to what a Laplace posterior expects.
A Bayesian bound holds on average over motions as lively as its prior allows; what no view sees may
be guessed better in a calm motion, so errors of seen joints are given by themselves.

Differences between rigs are paired by frame; their error bars take a second of motion as one draw.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body import Proportions
from egocap.commandline import progress
from egocap.errors import InputError
from egocap.evaluate.table import Table, number
from egocap.labels import EVALUATED, LABELS
from egocap.rig import Rig
from egocap.rig_files import parse_rig
from evals.study import Outcome

DEFAULTS: dict[str, float] = {
    "baseline": 0.35, "forward": 0.37, "up": 0.14, "pitch": 90.0, "toe_out": 0.0, "fov": 180.0,
}  # fmt: skip
"""EgoRig1: metres and degrees, as in rig files; `fov` spans the width of the image."""
SIZE = (640, 512)
SUITE = ("walk", "bike", "basketball", "juggler", "vr", "live")
FRAMES_A_MOTION = 50
MOST_CANDIDATES = 2000
FPS = 30.0
BLOCK_S = 1.0
MODEL_ERROR_M = 0.0
"""Scatter of true joints about the skeleton: none, the tracker's fits these motions to 0.1 mm."""
_TRACKED_COLUMNS = (
    "smoothed_mm", "posterior_mm", "tracked_mm", "smoothed_seen_mm", "tracked_seen_mm",
)  # fmt: skip
PAPERS = (0.30, 0.40)
"""Baselines in metres that the paper found to be best."""


@dataclass(frozen=True)
class Sweep:
    """Values of one measure of a rig."""

    name: str
    values: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Motion:
    """One simulated motion at the camera's frame rate."""

    name: str
    joints: Float[Array, "T 18 3"]  # true, head frame
    angles: Float[Array, "T 37"]  # of the tracker's skeleton, nearest to them
    proportions: Proportions

    @property
    def times(self) -> Float[Array, "T"]:
        """Seconds."""
        return np.arange(len(self.joints)) / FPS


@dataclass(frozen=True, eq=False)
class Candidate:
    """A rig and what it can know."""

    measures: Mapping[str, float]
    seen_any: float  # share of joints and frames that a view sees
    seen_both: float
    squared_mm2: Float[Array, "B"]  # bound of every frame: mean over joints
    per_joint_mm: Float[Array, "17"]  # root mean square over frames
    tracked: Mapping[str, float] = field(default_factory=dict)

    @property
    def bound_mm(self) -> float:
        """Root mean square over frames and joints."""
        return float(np.sqrt(self.squared_mm2.mean()))


@dataclass(frozen=True, eq=False)
class RigReport:
    """All candidates of a sweep."""

    candidates: tuple[Candidate, ...]
    sweeps: tuple[Sweep, ...]
    blocks: Float[Array, "B"]  # second of motion each frame belongs to
    settings: dict[str, Any]

    @property
    def best(self) -> Candidate:
        """The lowest bound."""
        return min(self.candidates, key=lambda c: c.bound_mm)

    def pareto(self) -> list[Candidate]:
        """Candidates that no narrower rig bounds lower."""
        front: list[Candidate] = []
        for c in sorted(self.candidates, key=lambda c: (c.measures["baseline"], c.bound_mm)):
            if not front or c.bound_mm < front[-1].bound_mm - 1e-9:
                front.append(c)
        return front

    def above(self, candidate: Candidate, other: Candidate) -> tuple[float, float]:
        """How much higher one bound is than another, mm, and its standard error."""
        scale = 1.0 / (candidate.bound_mm + other.bound_mm)  # d(sqrt m) = dm / (2 sqrt m)
        difference = candidate.squared_mm2 - other.squared_mm2
        means = np.array([difference[self.blocks == b].mean() for b in np.unique(self.blocks)])
        error = means.std(ddof=1) / np.sqrt(len(means)) if len(means) > 1 else 0.0
        return float(scale * difference.mean()), float(scale * error)

    def recommendation(self) -> str:
        """What to build, in words with numbers."""
        best = self.best
        near = [
            c for c in self.candidates
            if (d := self.above(c, best))[0] <= max(2.0 * d[1], 0.02 * best.bound_mm)
        ]  # fmt: skip
        compact = min(near, key=lambda c: (c.measures["baseline"], c.bound_mm))
        words = [
            f"Lowest bound: {best.bound_mm:.1f} mm with {_words(best, self.sweeps)}, "
            f"{100 * best.seen_any:.0f} % of joints seen by a camera, "
            f"{100 * best.seen_both:.0f} % by both.",
            f"{len(near)} of {len(self.candidates)} rigs are within 2 % or two standard errors "
            f"of it; the narrowest of them has {_words(compact, self.sweeps)} "
            f"({compact.bound_mm:.1f} mm).",
        ]
        claim = self.papers_claim()
        return " ".join(words + ([claim] if claim else []))

    def papers_claim(self) -> str:
        """Whether baselines of 30 to 40 cm are best, all else as the best rig has it."""
        same = [
            c for c in self.candidates
            if all(c.measures[s.name] == self.best.measures[s.name]
                   for s in self.sweeps if s.name != "baseline")
        ]  # fmt: skip
        low, high = PAPERS
        inside = [c for c in same if low <= c.measures["baseline"] <= high]
        outside = [c for c in same if not low <= c.measures["baseline"] <= high]
        if not inside or not outside:
            return ""
        ours = min(inside, key=lambda c: c.bound_mm)
        theirs = min(outside, key=lambda c: c.bound_mm)
        difference, error = self.above(ours, theirs)
        verdict = "is neither confirmed nor refuted"
        if abs(difference) > 2.0 * error:
            verdict = "is confirmed" if difference < 0.0 else "is refuted"
        return (
            f"The paper's 30 to 40 cm {verdict} by the bound: {ours.bound_mm:.1f} mm at "
            f"{ours.measures['baseline']:.2f} m, {theirs.bound_mm:.1f} mm at "
            f"{theirs.measures['baseline']:.2f} m, the best outside; difference "
            f"{difference:+.2f} +- {error:.2f} mm (one standard error)."
        )

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        rows = []
        for c in self.candidates:
            difference, error = self.above(c, self.best)
            joints = zip(EVALUATED, c.per_joint_mm, strict=True)
            rows.append({
                "measures": {k: round(v, 4) for k, v in c.measures.items()},
                "seen_any": round(c.seen_any, 4), "seen_both": round(c.seen_both, 4),
                "bound_mm": round(c.bound_mm, 3),
                "above_best_mm": round(difference, 3), "standard_error_mm": round(error, 3),
                "per_joint_mm": {LABELS[j]: round(float(v), 2) for j, v in joints},
                "tracked": {k: round(v, 2) for k, v in c.tracked.items()},
            })  # fmt: skip
        front = [dict(c.measures) for c in self.pareto()]
        return {"settings": self.settings, "recommendation": self.recommendation(),
                "pareto": front, "candidates": rows}  # fmt: skip

    def to_table(self) -> Table:
        """The Pareto front and the tracked candidates."""
        names = [s.name for s in self.sweeps]
        shown = self.pareto() + [c for c in self.candidates if c.tracked and c not in self.pareto()]
        shown.sort(key=lambda c: [c.measures[n] for n in names])
        header = (*names, "seen %", "both %", "bound mm", "motion bound", "posterior", "tracked",
                  "bound seen", "tracked seen")  # fmt: skip
        rows = tuple(
            (*(f"{c.measures[n]:g}" for n in names), number(100 * c.seen_any),
             number(100 * c.seen_both), number(c.bound_mm),
             *(number(c.tracked.get(k)) for k in _TRACKED_COLUMNS))
            for c in shown
        )  # fmt: skip
        return Table("Rigs that no narrower one beats, and tracked ones", header, rows)


def parse_sweep(text: str) -> Sweep:
    """Read 'baseline=0.05:0.60:12' (from, to, how many) or 'up=0.1'. Raises InputError."""
    form = f"NAME=LOW:HIGH:COUNT or NAME=VALUE, NAME one of {', '.join(DEFAULTS)}"
    name, equals, rest = text.partition("=")
    if name not in DEFAULTS or not equals:
        raise InputError(f"a sweep '{text}'", valid=form)
    try:
        numbers = [float(part) for part in rest.split(":")]
    except ValueError:
        raise InputError(f"not a number in the sweep '{text}'", valid=form) from None
    if not np.isfinite(numbers).all():
        raise InputError(f"not a finite number in the sweep '{text}'", valid=form)
    if len(numbers) == 1:
        return Sweep(name, (numbers[0],))
    if len(numbers) != 3:
        raise InputError(f"the sweep '{text}' is not a range", valid=form)
    low, high, count = numbers
    if not low < high or count != int(count) or not 2 <= count <= MOST_CANDIDATES:
        raise InputError(f"the sweep '{text}' is not a range",
                         valid="LOW below HIGH, COUNT a whole number from 2")  # fmt: skip
    return Sweep(name, tuple(round(float(v), 6) for v in np.linspace(low, high, int(count))))


def make_rig(measures: Mapping[str, float]) -> Rig:
    """A stereo rig of two equidistant cameras. Raises FileError for impossible measures."""
    stereo = {n: measures[n] for n in ("baseline", "forward", "up", "pitch", "toe_out")}
    lens = {"model": "equidistant", "width": SIZE[0], "height": SIZE[1], "fov": measures["fov"]}
    return parse_rig({"name": "candidate", "lens": lens, "stereo": stereo}, "sweep")


def load_suite(names: Sequence[str], frames: int) -> list[Motion]:
    """Simulate the motions of built-in scenes, without pictures."""
    from egocap.geometry import inverse, transform
    from egocap_sim.bodies import INDEX
    from egocap_sim.builtin import builtin_file
    from egocap_sim.proportions import proportions_of
    from egocap_sim.scene import load_scene
    from egocap_sim.stage import perform, person_of
    from egocap_sim.truth import label_positions
    from evals.learn_posture import fit_angles

    motions = []
    for name in names:
        scene = load_scene(builtin_file("scene", name)).model_copy(update={"frames": frames})
        person = person_of(scene)
        bodies = perform(scene, person).T_world_body
        joints = transform(inverse(bodies[:, INDEX["head"]]), label_positions(person, bodies))
        proportions = proportions_of(person)
        motions.append(Motion(name, joints, fit_angles(joints, proportions), proportions))
    return motions


def run_rig(
    sweeps: Sequence[Sweep],
    *,
    sigma: float,
    suite: Sequence[str] = SUITE,
    frames: int = 300,
    tracked: int = 0,
    seed: int = 0,
) -> RigReport:
    """Bound every rig of the grid that the sweeps span; track `tracked` of them, evenly along the
    first sweep with the other measures at the best rig's. Raises InputError, FileError."""
    names = [s.name for s in sweeps]
    if not sweeps or len(set(names)) != len(names):
        raise InputError(f"sweeps of {', '.join(names) or 'nothing'}", valid="each measure once")
    grid = list(product(*(s.values for s in sweeps)))
    if len(grid) > MOST_CANDIDATES:
        raise InputError(f"{len(grid)} rigs", valid=f"at most {MOST_CANDIDATES}")
    measures = [DEFAULTS | dict(zip(names, values, strict=True)) for values in grid]
    rigs = [make_rig(m) for m in measures]  # refuse before any work
    motions = load_suite(suite, frames)
    few = [_thinned(motion) for motion in motions]
    with progress("bounds", len(rigs), unit="rigs") as advance:
        candidates = []
        for m, rig in zip(measures, rigs, strict=True):
            candidates.append(bound(m, rig, few, sigma))
            advance()
    blocks = np.concatenate(
        [1000.0 * i + np.floor(_thin(m, m.times) / BLOCK_S) for i, m in enumerate(motions)]
    )
    settings = {"suite": list(suite), "frames_a_motion": frames, "sigma_px": sigma,
                "image_size": list(SIZE), "model_error_m": MODEL_ERROR_M, "seed": seed,
                "defaults": DEFAULTS}  # fmt: skip
    report = RigReport(tuple(candidates), tuple(sweeps), blocks, settings)
    return _with_tracks(report, motions, sigma, tracked, seed) if tracked else report


def bound(
    measures: Mapping[str, float], rig: Rig, motions: Sequence[Motion], sigma: float
) -> Candidate:
    """Visibility and Bayesian bound of one rig."""
    from egocap.posterior.information import (
        Noise,
        fisher_information,
        joint_covariance,
        prior_information,
        rms_mm,
    )

    noise = Noise(sigma, model_error_m=MODEL_ERROR_M)
    squared, seen_all = [], []
    for motion in motions:
        seen = seen_by(rig, motion)
        information = fisher_information(motion.angles, motion.proportions, rig, seen, noise)
        covariance = np.linalg.inv(information + prior_information(motion.angles))
        joints = joint_covariance(motion.angles, motion.proportions, covariance)
        squared.append(rms_mm(joints)[:, list(EVALUATED)] ** 2)
        seen_all.append(seen[..., list(EVALUATED)])
    each, seen = np.concatenate(squared), np.concatenate(seen_all)
    return Candidate(
        dict(measures), float(seen.any(1).mean()), float(seen.all(1).mean()), each.mean(1),
        np.sqrt(each.mean(0)),
    )  # fmt: skip


def seen_by(rig: Rig, motion: Motion) -> Bool[Array, "T V 18"]:
    """Which joints each view sees of a motion."""
    from egocap.gaussians import GaussianBody
    from egocap.posterior.occlusion import joints_seen

    body = GaussianBody.from_proportions(motion.proportions)
    return joints_seen(motion.angles, motion.joints, body, rig)


def track_errors(rig: Rig, motions: Sequence[Motion], sigma: float, seed: int) -> dict[str, float]:
    """Root mean square errors [mm] over the suite: the bound given the whole motion, what a Laplace
    posterior of a frame expects, its mode's, and the tracker's."""
    from egocap.detect.simulated import SimulatedSource, simulate_detections
    from egocap.posterior.information import (
        Noise,
        fisher_information,
        joint_covariance,
        prior_information,
        rms_mm,
        smoothed_covariance,
    )
    from egocap.track.config import TrackerConfig
    from egocap.track.tracker import track

    config, noise = TrackerConfig(), Noise(sigma, model_error_m=MODEL_ERROR_M)
    totals: dict[str, list[Array]] = {
        k: [] for k in ("smoothed_mm", "smoothed_seen_mm", "posterior_mm", "mode_mm", "tracked_mm",
                        "tracked_seen_mm")
    }  # fmt: skip
    rng = np.random.default_rng(seed)
    for motion in motions:
        seen = seen_by(rig, motion)
        pixels = np.moveaxis(rig.project(motion.joints)[0], 0, 1)
        source = SimulatedSource(sigma)
        found = simulate_detections(pixels, seen, seen, motion.times, SIZE, source, rng)
        result = track(found, rig, motion.proportions, config)
        errors, mine = (
            _errors(result.joints_head, motion.joints),
            np.any(seen, axis=1)[:, list(EVALUATED)],
        )
        totals["tracked_mm"].append(errors.ravel())
        totals["tracked_seen_mm"].append(errors[mine])
        information = fisher_information(motion.angles, motion.proportions, rig, seen, noise)
        information = information + prior_information(motion.angles, config.lambda_posture)
        covariance = smoothed_covariance(information, motion.times, config.acceleration)
        bounds = rms_mm(joint_covariance(motion.angles, motion.proportions, covariance))
        bounds = bounds[:, list(EVALUATED)]
        totals["smoothed_mm"].append(bounds.ravel())
        totals["smoothed_seen_mm"].append(bounds[mine])
        expected, error = _laplace(found, rig, motion, seed)
        totals["posterior_mm"].append(expected.ravel())
        totals["mode_mm"].append(error.ravel())
    return {
        name: float(np.sqrt(np.mean(np.concatenate(parts) ** 2))) for name, parts in totals.items()
    }


def check_visibility(folders: Sequence[Path]) -> dict[str, float]:
    """Share of joints in view on which occlusion by the body agrees with the renderer's, per kind
    of joint; what hides them must be the wearer, not others."""
    from egocap.gaussians import GaussianBody
    from egocap.posterior.occlusion import joints_seen
    from egocap.sequence import OCCLUDED, VISIBLE, open_sequence
    from evals.learn_posture import fit_angles

    hits: dict[str, list[Array]] = {}
    for folder in folders:
        sequence = open_sequence(folder)
        truth = sequence.truth
        angles = fit_angles(truth.joints_head, sequence.proportions)
        body = GaussianBody.from_proportions(sequence.proportions)
        seen = joints_seen(angles, truth.joints_head, body, sequence.true_rig)
        counts = truth.in_view & (truth.visibility != OCCLUDED)
        agree = seen == (truth.visibility == VISIBLE)
        for j in EVALUATED:
            kind = LABELS[j].rpartition("_")[2]
            hits.setdefault(kind, []).append(agree[..., j][counts[..., j]])
            hits.setdefault("all", []).append(agree[..., j][counts[..., j]])
    return {kind: float(np.concatenate(parts).mean()) for kind, parts in hits.items()}


def _with_tracks(
    report: RigReport, motions: Sequence[Motion], sigma: float, count: int, seed: int
) -> RigReport:
    first, best = report.sweeps[0], report.best
    line = [
        c for c in report.candidates
        if all(c.measures[s.name] == best.measures[s.name] for s in report.sweeps[1:])
    ]  # fmt: skip
    line.sort(key=lambda c: c.measures[first.name])
    places = np.unique(np.linspace(0, len(line) - 1, min(count, len(line))).round().astype(int))
    chosen = {id(line[i]) for i in places}
    done = []
    with progress("tracks", len(chosen), unit="rigs") as advance:
        for c in report.candidates:
            if id(c) in chosen:
                errors = track_errors(make_rig(c.measures), motions, sigma, seed)
                done.append(replace(c, tracked=errors))
                advance()
            else:
                done.append(c)
    return replace(report, candidates=tuple(done))


def _laplace(
    found: Any, rig: Rig, motion: Motion, seed: int
) -> tuple[Float[Array, "B 17"], Float[Array, "B 17"]]:
    """Expected spread and error of the mode [mm] of a dozen frames, each by itself."""
    from egocap.posterior.config import PosteriorConfig
    from egocap.posterior.laplace import find_modes
    from egocap.posterior.log_prob import log_posterior_of
    from egocap.posterior.sampler import laplace_joints

    config = PosteriorConfig(degrees=np.inf, model_error_m=MODEL_ERROR_M)
    expected, errors = [], []
    for t in np.linspace(0, len(motion.joints) - 1, 12).astype(int):
        density = log_posterior_of(found, int(t), rig, motion.proportions, config)
        mode = find_modes(density, np.random.default_rng(seed))[0]
        spread = np.trace(laplace_joints(density, mode), axis1=1, axis2=2)
        expected.append(1e3 * np.sqrt(spread[list(EVALUATED)]))
        errors.append(_errors(density.joints(mode.mean[None]), motion.joints[t : t + 1])[0])
    return np.array(expected), np.array(errors)


def _errors(joints: Float[Array, "T 18 3"], truth: Float[Array, "T 18 3"]) -> Float[Array, "T 17"]:
    return 1e3 * np.linalg.norm(joints - truth, axis=-1)[:, list(EVALUATED)]


def _thin(motion: Motion, rows: Array) -> Array:
    return rows[:: max(1, len(motion.joints) // FRAMES_A_MOTION)]


def _thinned(motion: Motion) -> Motion:
    return replace(motion, joints=_thin(motion, motion.joints), angles=_thin(motion, motion.angles))


def _words(candidate: Candidate, sweeps: Sequence[Sweep]) -> str:
    units = {"pitch": " degrees", "toe_out": " degrees", "fov": " degrees"}
    names = {"toe_out": "toe-out", "fov": "field of view"}
    return ", ".join(
        f"{names.get(s.name, s.name)} {candidate.measures[s.name]:g}{units.get(s.name, ' m')}"
        for s in sweeps
    )


def study(
    sweep: tuple[str, ...] = ("baseline=0.05:0.60:12", "fov=120:220:6"),
    sigma: float = 2.0,
    suite: tuple[str, ...] = SUITE,
    frames: int = 300,
    tracked: int = 0,
    seed: int = 0,
    check: tuple[Path, ...] = (),
    page: Path | None = None,
) -> Outcome:
    """What stereo rigs can know of a suite of motions: visibility, bound, tracked error.

    Args:
        sweep: Measures to vary, NAME=LOW:HIGH:COUNT or NAME=VALUE: baseline, forward, up (metres),
            pitch, toe_out, fov (degrees). What is not named is EgoRig1's.
        sigma: Spread of the detections, pixels at a width of 640.
        suite: Built-in scenes whose motions are simulated.
        frames: Frames of each.
        tracked: How many rigs along the first sweep to track, too.
        seed: Of the tracked detections' noise.
        check: Rendered sequences on which to compare the visibility with the renderer's.
        page: Pictures and the recommendation, html.
    """
    sweeps = [parse_sweep(text) for text in sweep]
    if not 0.0 < sigma < np.inf:
        raise InputError(f"detections with sigma {sigma}", valid="above 0 px")
    if frames < 3 or tracked < 0 or seed < 0:
        raise InputError(f"frames {frames}, tracked {tracked}, seed {seed}",
                         valid="3 frames or more, the others from 0")  # fmt: skip
    report = run_rig(sweeps, sigma=sigma, suite=suite, frames=frames, tracked=tracked, seed=seed)
    result = report.to_dict()
    tables = [report.to_table(), Table("", ("recommendation",), ((result["recommendation"],),))]
    if check:
        agree = check_visibility(check)
        result["visibility_agreement"] = {kind: round(share, 4) for kind, share in agree.items()}
        rows = tuple((kind, number(100 * share)) for kind, share in agree.items())
        tables.append(Table("Visibility as the renderer's, %", ("joint", "agree"), rows))
    if page is not None:
        from evals.rig_plots import write_rig_page

        write_rig_page(page, report)
    return Outcome(result, tables)
