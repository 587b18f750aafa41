"""The effect of each part of the tracker (paper, section 5.5): tracking without it, over people.

The paper leaves out smoothness (30 mm worse), colour (5 mm worse) and detections (track lost). The
same terms are left out of its energy, with its stochastic solver, and each improvement in turn of
our tracker. Every scene is acted by its own person and by others. Changes are paired by sequence;
error bars are over the sequences.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from tyro.conf import OmitArgPrefixes, arg

import egocap
from egocap.body.labels import EVALUATED, LOWER, UPPER
from egocap.commandline import progress
from egocap.data.detections import Detections
from egocap.data.sequence import Sequence as Footage
from egocap.data.track import Track
from egocap.data.truth import VISIBLE
from egocap.detect.sources import detections_from
from egocap.detect.synthetic import LEARNED_LIKE
from egocap.detect.weights import open_weights
from egocap.errors import InputError
from egocap.evaluation.table import Table, number
from egocap.pose.config import TrackerConfig
from egocap_eval.harness.cases import (
    ScoreLog,
    Scores,
    mean,
    paired_change,
    run_cases,
    subject_means,
)
from egocap_eval.harness.footage import builtin_scene, content_hashes, prepare_sequence
from egocap_eval.harness.intervals import format_interval, mean_and_interval, share_and_interval
from egocap_eval.harness.study import Outcome
from egocap_eval.sets.test_log import log_look
from egocap_eval.studies.recorded import clip_seeds, scenes_of
from egocap_eval.studies.recovery import (
    FOUND_MM,
    LOST_MM,
    ColourFollower,
    by_colours,
    by_detections,
    draw_trials,
)
from egocap_sim.scene.config import Scene

SCENES = ("validation-walk", "validation-gesture")
OTHER_PEOPLE = 401_000
"""Seed of the second person of the first scene; further ones count up from it."""
WHOLE, WITHOUT_DETECTIONS, COLOUR = "whole", "without detections", "with colour"
PAST, SINGLE = "past only", "without smoothness"
VARIANTS: Mapping[str, Mapping[str, Any]] = {
    WHOLE: {},
    COLOUR: {"colour": True},
    "without motion prior": {"lambda_motion": 0.0},
    "without posture prior": {"lambda_posture": 0.0},
    PAST: {"smoothing": "none"},
    "past only, low-pass as the paper's": {"smoothing": "gaussian"},
    SINGLE: {"smoothing": "none", "lambda_smooth": 0.0},
    "without other modes": {"use_modes": False},
    "without swap correction": {"fix_swaps": False},
    "without noise estimation": {"estimate_noise": False},
    "without multi-start": {"multistart": False},
    "without appearance check": {"appearance_check": False},
    "without all of these": {
        "smoothing": "gaussian", "lambda_motion": 0.0, "lambda_posture": 0.0, "use_modes": False,
        "fix_swaps": False, "estimate_noise": False, "multistart": False,
        "appearance_check": False,
    },
    WITHOUT_DETECTIONS: {},
}  # fmt: skip
"""Tracker settings by the part that they leave out or add."""
PAPER = "the paper's"
PAPERS: Mapping[str, Mapping[str, float]] = {
    PAPER: {},
    f"{PAPER}, without smoothness": {"lambda_smooth": 0.0},
    f"{PAPER}, without colour": {"lambda_colour": 0.0},
    f"{PAPER}, without detections": {"lambda_detection": 0.0},
}
"""Changed weights of the paper's energy."""
PAPER_FRAMES = 125
"""Frames of each sequence that the paper's solver tracks: it is slow."""
MEASURES = ("mpjpe_mm", "upper_mm", "lower_mm", "seen_mm", "hidden_mm", "lost_percent")
SETTLE_S = 1.0
"""Time that a tracker has to recover."""


@dataclass(frozen=True)
class RecordedClips:
    """Recorded motions in place of the scenes."""

    motions: Annotated[Path | None, arg(metavar="DIR")] = None
    """Track the recorded clips of a set in this folder, each by another person, instead."""
    set: Literal["validation", "test"] = "validation"
    """Set of clips; a look at the test set is logged."""
    reason: str | None = None
    """Why the test set is looked at."""

    def scenes(self, frames: int) -> list[Scene]:
        """The middle frames of each clip. Raises InputError for a look that is not allowed."""
        assert self.motions is not None
        seeds = clip_seeds(self.motions, self.set, ())
        if self.set == "test":
            log_look(self.reason, open_weights().sha256)
        return [scenes_of(path, seed, frames)[0] for path, seed in seeds.items()]


def study(
    work: Annotated[Path, arg(metavar="DIR")] = Path("out/ablation"),
    recorded: Annotated[RecordedClips, OmitArgPrefixes] = RecordedClips(),
    detections: str = LEARNED_LIKE,
    people: int = 3,
    seeds: int = 2,
    frames: int = 250,
    size: tuple[int, int] = (640, 512),
    workers: int = 2,
    colour: bool = True,
    trials: int = 8,
    keep: Annotated[Path | None, arg(metavar="FILE")] = None,
) -> Outcome:
    """Track with one part left out at a time (paper, section 5.5).

    Args:
        work: Folder of the sequences; made where they are missing.
        recorded: Recorded motions in place of the scenes.
        detections: Source of detections, as for `egocap track`.
        people: People who act each scene: its own and others.
        seeds: Draws of the detections' errors.
        frames: Frames of each scene.
        size: Image width and height, pixels.
        workers: Rendering processes.
        colour: Skip the variants that use colours, the paper's energy among them.
        trials: Recovery trials in each sequence; 0 for none.
        keep: Finished scores; the same command continues from them after a stop.
    """
    for count, name in ((people, "people"), (seeds, "seeds"), (frames, "frames")):
        if count < 1:
            raise InputError(f"{count} {name}", valid="1 or more")
    if trials < 0:
        raise InputError(f"{trials} trials", valid="0 or more")
    clips = recorded.motions is not None
    scenes = recorded.scenes(frames) if clips else make_scenes(people, frames, size)
    footage = [prepare_sequence(scene, work / scene.name, workers) for scene in scenes]
    subjects = {f.manifest.name: f for f in footage}
    log = ScoreLog(keep, detections=detections, frames=frames, size=size)
    names = [name for name in VARIANTS if colour or name != COLOUR]
    measured = measure_variants(names, subjects, detections, seeds, log)
    measured |= measure_variants(list(PAPERS) if colour else [], subjects, detections, 1, log)
    rows = [summarise(name, found, measured[PAPER if name in PAPERS else WHOLE])
            for name, found in measured.items()]  # fmt: skip
    recovery = measure_recovery(footage, detections, trials, colour) if trials else {}
    result = {
        "protocol": "egocap-17", "detections": detections, "people": people, "seeds": seeds,
        "sequences": list(subjects), "rows": rows, "statements": statements(measured) | recovery,
    }  # fmt: skip
    tables = [_variants_table(rows), *_statement_tables(result["statements"])]
    return Outcome(result, tables, config=content_hashes(footage))


def make_scenes(people: int, frames: int, size: tuple[int, int]) -> list[Scene]:
    """The scenes, each acted by `people` people."""
    scenes = []
    for i, name in enumerate(SCENES):
        scene = builtin_scene(name, size)
        scene = scene.model_copy(update={"frames": min(frames, scene.frames)})
        for person in range(people):
            seed = scene.seed if person == 0 else OTHER_PEOPLE + 100 * i + person
            scenes.append(scene.model_copy(update={"seed": seed, "name": f"{name}-{person}"}))
    return scenes


def measure_variants(
    names: Sequence[str], footage: Mapping[str, Footage], source: str, seeds: int,
    log: ScoreLog | None = None,
) -> dict[str, dict[str, list[float | None]]]:  # fmt: skip
    """By variant, each measure of every sequence: a mean over the draws of the detections."""

    def score(variant: str, sequence: Footage, seed: int) -> Scores:
        return measure_errors(sequence, tracked(variant, sequence, source, seed))

    cases = {name: name for name in names}
    runs = run_cases("variants", cases, footage, score, seeds=seeds, log=log)
    return {name: subject_means(runs[name], MEASURES) for name in names}


def tracked(variant: str, footage: Footage, source: str, seed: int) -> Track:
    """A sequence tracked by a variant from one draw of its detections."""
    from egocap.paper.config import STOCHASTIC
    from egocap.paper.tracker import PaperTracker

    detections = detections_from(footage, source, seed)
    person = footage.rig, footage.body
    if variant in PAPERS:
        config = replace(STOCHASTIC, **PAPERS[variant])
        return PaperTracker(*person, config).track(detections[:PAPER_FRAMES], footage.images)
    found = _blind(detections) if variant == WITHOUT_DETECTIONS else detections
    return egocap.Tracker(*person, TrackerConfig(**VARIANTS[variant])).track(found, footage.images)


def measure_errors(footage: Footage, track: Track) -> dict[str, float | None]:
    """Each of `MEASURES`, of the track of a sequence's first frames."""
    truth, rows = footage.truth, slice(0, len(track.times))
    error = 1e3 * np.linalg.norm(track.joints_head - truth.joints_head[rows], axis=-1)
    seen = np.any(truth.visibility[rows] == VISIBLE, axis=1)
    counted = np.isin(np.arange(18), EVALUATED)
    hidden = error[~seen & counted]
    return {
        "mpjpe_mm": float(error[:, counted].mean()),
        "upper_mm": float(error[:, UPPER].mean()),
        "lower_mm": float(error[:, LOWER].mean()),
        "seen_mm": float(error[seen & counted].mean()),
        "hidden_mm": float(hidden.mean()) if hidden.size else None,
        "lost_percent": 100.0 * float((error[:, counted].mean(1) > LOST_MM).mean()),
    }


def summarise(
    name: str, found: Mapping[str, Sequence[float | None]], whole: Mapping[str, Sequence[Any]]
) -> dict[str, Any]:
    """Means of a variant over sequences and draws, and its change from the whole, in pairs."""
    rest = {key: mean(found[key]) for key in MEASURES if key != "mpjpe_mm"}
    return {"variant": name, "mpjpe_mm": mean_and_interval(found["mpjpe_mm"]),
            "change_mm": _change(whole, found), **rest}  # fmt: skip


def statements(measured: Mapping[str, Mapping[str, Sequence[Any]]]) -> dict[str, Any]:
    """Section 5.5's numbers: the mean error added by leaving a term out, mm."""
    added = {
        # all smoothing, of past and future; and Equation 3's alone
        "without_smoothness_mm": _change(measured[WHOLE], measured[SINGLE]),
        "without_smoothness_live_mm": _change(measured[PAST], measured[SINGLE]),
    }
    if COLOUR in measured:
        added["without_colour_mm"] = _change(measured[COLOUR], measured[WHOLE])
    for part in ("smoothness", "colour", "detections"):
        if (name := f"{PAPER}, without {part}") in measured:
            added[f"papers_without_{part}_mm"] = _change(measured[PAPER], measured[name])
    return added


def measure_recovery(
    footage: Sequence[Footage], source: str, trials: int, colour: bool
) -> dict[str, Any]:
    """Share of failures that trackers recover from within a second, and the final error."""
    ends: dict[str, list[float]] = {"with_detection": []}
    if colour:
        ends["without_detection"] = []
    begins = []
    with progress("recovery", len(footage), unit="sequences") as advance:
        for i, sequence in enumerate(footage):
            count = round(SETTLE_S * sequence.manifest.fps)
            detections = detections_from(sequence, source, 0)
            drawn = list(draw_trials(sequence, trials, count, np.random.default_rng([i, 5])))
            begins += [trial.error_mm for trial in drawn]
            ends["with_detection"] += [
                by_detections(sequence, detections, trial, count) for trial in drawn
            ]
            if colour:
                follow = ColourFollower(sequence, tracked(WHOLE, sequence, source, 0).angles)
                ends["without_detection"] += [
                    by_colours(sequence, follow, trial, count) for trial in drawn
                ]
            advance()
    found: dict[str, Any] = {"failure_mm": float(np.mean(begins)), "found_below_mm": FOUND_MM}
    for name, errors in ends.items():
        recovered = sum(error < FOUND_MM for error in errors)
        found[f"recovered_{name}"] = share_and_interval(recovered, len(errors))
        found[f"recovered_{name}"]["median_end_mm"] = float(np.median(errors))
    return found


def _change(
    before: Mapping[str, Sequence[Any]], after: Mapping[str, Sequence[Any]]
) -> dict[str, float] | None:
    return paired_change(before["mpjpe_mm"], after["mpjpe_mm"])


def _blind(detections: Detections) -> Detections:
    """The same times with nothing detected."""
    return replace(detections, valid=np.zeros_like(detections.valid))


def _variants_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    header = ("variant", "MPJPE mm", "change", "upper", "lower", "seen", "hidden", "lost %")
    return Table("Tracking with one part left out (95 % intervals over sequences)", header, tuple(
        (row["variant"], format_interval(row["mpjpe_mm"]), format_interval(row["change_mm"]),
         *(number(row[key]) for key in MEASURES if key != "mpjpe_mm"))
        for row in rows
    ))  # fmt: skip


def _statement_tables(found: Mapping[str, Any]) -> list[Table]:
    paper = {"without_smoothness_mm": "30", "without_smoothness_live_mm": "30",
             "papers_without_smoothness_mm": "30", "without_colour_mm": "5",
             "papers_without_colour_mm": "5", "papers_without_detections_mm": "-"}  # fmt: skip
    added = tuple((name.removesuffix("_mm").replace("_", " "), value, format_interval(found[name]))
                  for name, value in paper.items() if name in found)  # fmt: skip
    shares = tuple(
        (name.removeprefix("recovered_").replace("_", " "), str(entry["trials"]),
         f"{number(entry['percent'], 0)} ({number(entry['low'], 0)} to {number(entry['high'], 0)})",
         number(entry["median_end_mm"]))
        for name, entry in found.items() if name.startswith("recovered_")
    )  # fmt: skip
    tables = [Table("Error added, mm (section 5.5)", ("", "paper", "ours"), added)]
    if shares:
        title = f"Failures of {found['failure_mm']:.0f} mm, a second later"
        tables.append(Table(title, ("", "failures", "recovered %", "median mm"), shares))
    return tables
