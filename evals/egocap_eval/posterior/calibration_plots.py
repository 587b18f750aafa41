"""Pictures of a calibration study: reliability, every joint's coverage, ranks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from egocap.body.labels import EVALUATED, LABELS
from egocap_eval.posterior.coverage import (
    LEVELS,
    RANK_BINS,
    CalibrationReport,
    Coverage,
    rank_statistics,
)

COLOURS = ("#1d4ed8", "#c2410c", "#0f766e")


def write_diagrams(path: Path, report: CalibrationReport) -> None:
    """Write reliability, coverage of every joint and the ranks as an HTML page."""
    from egocap.posterior.figures import draw_reliability, write_pictures

    studies = [c for c in (report.well_specified, report.before, report.after) if c is not None]
    facts = list(report.missed())
    if report.well_specified is not None and not facts:
        facts.append("Well-specified coverage is within tolerance.")
    if report.model is not None:
        facts.append(f"Temperature by the correlation of errors: {report.model.temperature:.2f}.")
    drawn = [("Reliability", draw_reliability({c.name: c.curve() for c in studies}))]
    for study in studies:
        drawn.append((f"Every joint, {study.name}", draw_joints(study)))
        if study.scores[0].ranks is not None:
            drawn.append((f"Ranks, {study.name}", draw_ranks(study)))
    write_pictures(path, "Calibration of the posterior", drawn, facts=" ".join(facts))


def draw_joints(study: Coverage) -> Any:
    """Coverage of every joint at every level, with binomial error bars of 95 %."""
    figure, axes = _axes((7.5, 4.4))
    places = np.arange(len(EVALUATED))
    for level, colour in zip(LEVELS, COLOURS, strict=True):
        axes.axhline(100 * level, color=colour, lw=0.8, ls="--")
        shares, error = 100 * study.per_joint(level), 196 * study.binomial_error(level)
        axes.errorbar(places, shares, yerr=error, fmt="o", ms=3, capsize=2, color=colour,
                      label=f"{100 * level:g} %")  # fmt: skip
    names = [LABELS[j].replace("_", " ") for j in EVALUATED]
    axes.set_xticks(places, names, rotation=60, ha="right", fontsize=7)
    axes.set_ylabel("truths inside the region, %")
    axes.set_ylim(0, 102)
    axes.legend(title=f"{len(study.scores)} frames", fontsize=7, loc="lower right")
    return figure


def draw_ranks(study: Coverage) -> Any:
    """Histogram of the ranks of all true angles among their draws; even where draws are right."""
    figure, axes = _axes((7.0, 3.2))
    result = rank_statistics(study.scores)
    counts = np.array(result["histogram"])
    expected = counts.sum() / RANK_BINS
    axes.bar((np.arange(RANK_BINS) + 0.5) / RANK_BINS, counts, 0.9 / RANK_BINS, color="#64748b")
    # Angles of one frame go together: the band is that of a single angle's count, 37 times.
    frames, share = len(study.scores), 1.0 / RANK_BINS
    band = 1.96 * counts.sum() / frames * np.sqrt(frames * share * (1.0 - share))
    axes.axhspan(expected - band, expected + band, color="#fde68a", zorder=0,
                 label="95 % if a frame's angles all went together")  # fmt: skip
    axes.axhline(expected, color="#374151", lw=0.8)
    axes.set_xlabel("share of draws below the true angle")
    axes.set_ylabel("true angles")
    axes.set_title(f"smallest of 37 p values {result['smallest_p']:.3g}, its chance among as many "
                   f"{result['smallest_p_of_as_many']:.2f}", fontsize=8)  # fmt: skip
    axes.legend(fontsize=7, loc="lower right")
    return figure


def _axes(size: tuple[float, float]) -> Any:
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots()
