"""Result of a sweep of rigs: Pareto front, significance of differences, recommendation.

Differences between rigs are paired by frame; a second of motion counts as one draw.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.labels import EVALUATED, LABELS
from egocap.evaluation.table import Table, number
from egocap_eval.rig_design.rig_sweep import Sweep

PAPERS = (0.30, 0.40)
"""Baselines in metres that the paper found to be best."""
NEAR = 0.02
"""Rigs whose bound is higher than the best one's by no more than this share are as good."""
_TRACKED_COLUMNS = (
    "smoothed_mm", "posterior_mm", "tracked_mm", "smoothed_seen_mm", "tracked_seen_mm",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Tracked:
    """Errors of the tracker on a rig's simulated detections."""

    rms_mm: Mapping[str, float]  # by measure (`rig_bounds.track_errors`)
    squared_mm2: Float[Array, "F"]  # tracker's error of every frame: mean over joints

    @property
    def error_mm(self) -> float:
        """Root mean square error of the tracker over frames and joints."""
        return float(np.sqrt(self.squared_mm2.mean()))


@dataclass(frozen=True, eq=False)
class Candidate:
    """A rig, its visibility, error bound and tracked error."""

    measures: Mapping[str, float]
    seen_any: float  # share of joints and frames that a view sees
    seen_both: float
    squared_mm2: Float[Array, "B"]  # bound of every frame: mean over joints
    per_joint_mm: Float[Array, "17"]  # root mean square over frames
    tracked: Tracked | None = None

    @property
    def bound_mm(self) -> float:
        """Root mean square over frames and joints."""
        return float(np.sqrt(self.squared_mm2.mean()))


@dataclass(frozen=True, eq=False)
class RigReport:
    """All candidates of a sweep."""

    candidates: tuple[Candidate, ...]
    sweeps: tuple[Sweep, ...]
    blocks: Float[Array, "B"]  # second of motion each bounded frame belongs to
    settings: Mapping[str, Any]
    track_blocks: Float[Array, "F"] | None = None  # the same of each tracked frame

    @property
    def best(self) -> Candidate:
        """The lowest bound."""
        return min(self.candidates, key=lambda c: c.bound_mm)

    @property
    def tracked(self) -> list[Candidate]:
        """Those that were tracked, along the first sweep."""
        first = self.sweeps[0].name
        return sorted((c for c in self.candidates if c.tracked), key=lambda c: c.measures[first])

    def pareto(self) -> list[Candidate]:
        """Candidates that no narrower rig bounds lower."""
        front: list[Candidate] = []
        for c in sorted(self.candidates, key=lambda c: (c.measures["baseline"], c.bound_mm)):
            if not front or c.bound_mm < front[-1].bound_mm - 1e-9:
                front.append(c)
        return front

    def above(self, candidate: Candidate, other: Candidate) -> tuple[float, float]:
        """How much higher one bound is than another, mm, and its standard error."""
        return difference_mm(candidate.squared_mm2, other.squared_mm2, self.blocks)

    def tracked_above(self, candidate: Candidate, other: Candidate) -> tuple[float, float]:
        """The same of the tracker's errors; both must have been tracked."""
        assert candidate.tracked and other.tracked and self.track_blocks is not None
        return difference_mm(
            candidate.tracked.squared_mm2, other.tracked.squared_mm2, self.track_blocks
        )

    def recommendation(self) -> str:
        """The recommended rigs, as text."""
        best = self.best
        near = [
            c for c in self.candidates
            if (d := self.above(c, best))[0] <= max(2.0 * d[1], NEAR * best.bound_mm)
        ]  # fmt: skip
        compact = min(near, key=lambda c: (c.measures["baseline"], c.bound_mm))
        words = [
            f"Lowest bound: {best.bound_mm:.1f} mm with {_words(best, self.sweeps)}, "
            f"{100 * best.seen_any:.0f} % of joints seen by a camera, "
            f"{100 * best.seen_both:.0f} % by both.",
            f"{len(near)} of {len(self.candidates)} rigs are within {100 * NEAR:.0f} % or two "
            f"standard errors of it; the narrowest of them has {_words(compact, self.sweeps)} "
            f"({compact.bound_mm:.1f} mm).",
        ]
        words.append(self.papers_claim())
        if self.tracked:
            words += [self._on_tracks(), self.papers_claim_tracked()]
        return " ".join(word for word in words if word)

    def papers_claim(self) -> str:
        """Whether baselines of 30 to 40 cm are best, other measures as in the best rig."""
        same = [
            c for c in self.candidates
            if all(c.measures[s.name] == self.best.measures[s.name]
                   for s in self.sweeps if s.name != "baseline")
        ]  # fmt: skip
        return _verdict("the bound", same, lambda c: c.bound_mm, self.above)

    def papers_claim_tracked(self) -> str:
        """The same by the tracker's errors."""
        if self.sweeps[0].name != "baseline":
            return ""
        return _verdict("the tracker's error", self.tracked, _error, self.tracked_above)

    def _on_tracks(self) -> str:
        best = min(self.tracked, key=_error)
        near = [
            c for c in self.tracked
            if (d := self.tracked_above(c, best))[0] <= max(2.0 * d[1], NEAR * _error(best))
        ]  # fmt: skip
        compact = min(near, key=lambda c: (c.measures["baseline"], _error(c)))
        return (
            f"Tracked: the lowest error is {_error(best):.1f} mm with {_words(best, self.sweeps)}; "
            f"{len(near)} of {len(self.tracked)} tracked rigs are as good within {100 * NEAR:.0f} "
            f"% or two standard errors, the narrowest with {_words(compact, self.sweeps)} "
            f"({_error(compact):.1f} mm)."
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
                "tracked": {k: round(v, 2) for k, v in c.tracked.rms_mm.items()}
                if c.tracked else {},
            })  # fmt: skip
        front = [dict(c.measures) for c in self.pareto()]
        return {"settings": dict(self.settings), "recommendation": self.recommendation(),
                "pareto": front, "candidates": rows}  # fmt: skip

    def to_table(self) -> Table:
        """The Pareto front and the tracked candidates."""
        names = [s.name for s in self.sweeps]
        front = self.pareto()
        shown = front + [c for c in self.candidates if c.tracked and c not in front]
        shown.sort(key=lambda c: [c.measures[n] for n in names])
        header = (*names, "seen %", "both %", "bound mm", "motion bound", "posterior", "tracked",
                  "bound seen", "tracked seen")  # fmt: skip
        rows = tuple(
            (*(f"{c.measures[n]:g}" for n in names), number(100 * c.seen_any),
             number(100 * c.seen_both), number(c.bound_mm),
             *(number(c.tracked.rms_mm[k] if c.tracked else None) for k in _TRACKED_COLUMNS))
            for c in shown
        )  # fmt: skip
        return Table("Rigs that no narrower one beats, and tracked ones", header, rows)


def difference_mm(
    squared: Float[Array, "B"], other: Float[Array, "B"], blocks: Float[Array, "B"]
) -> tuple[float, float]:
    """Difference of two root mean squares, and its standard error over blocks of frames."""
    total = np.sqrt(squared.mean()) + np.sqrt(other.mean())
    scale = 1.0 / total if total > 0.0 else 0.0  # a - b = (a^2 - b^2) / (a + b)
    away = squared - other
    means = np.array([away[blocks == b].mean() for b in np.unique(blocks)])
    error = means.std(ddof=1) / np.sqrt(len(means)) if len(means) > 1 else 0.0
    return float(scale * away.mean()), float(scale * error)


def _verdict(
    by: str,
    candidates: Sequence[Candidate],
    value: Callable[[Candidate], float],
    above: Callable[[Candidate, Candidate], tuple[float, float]],
) -> str:
    low, high = PAPERS
    inside = [c for c in candidates if low <= c.measures["baseline"] <= high]
    outside = [c for c in candidates if not low <= c.measures["baseline"] <= high]
    if not inside or not outside:
        return ""
    ours, theirs = min(inside, key=value), min(outside, key=value)
    difference, error = above(ours, theirs)
    verdict = "is neither confirmed nor refuted"
    if abs(difference) > 2.0 * error:
        verdict = "is confirmed" if difference < 0.0 else "is refuted"
    return (
        f"The paper's 30 to 40 cm {verdict} by {by}: {value(ours):.1f} mm at "
        f"{ours.measures['baseline']:.2f} m, {value(theirs):.1f} mm at "
        f"{theirs.measures['baseline']:.2f} m, the best outside; difference "
        f"{difference:+.2f} +- {error:.2f} mm (one standard error)."
    )


def _error(candidate: Candidate) -> float:
    assert candidate.tracked is not None
    return candidate.tracked.error_mm


def _words(candidate: Candidate, sweeps: Sequence[Sweep]) -> str:
    units = {"pitch": " degrees", "toe_out": " degrees", "fov": " degrees"}
    names = {"toe_out": "toe-out", "fov": "field of view"}
    return ", ".join(
        f"{names.get(s.name, s.name)} {candidate.measures[s.name]:g}{units.get(s.name, ' m')}"
        for s in sweeps
    )
