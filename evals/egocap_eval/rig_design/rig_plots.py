"""Pictures of a rig study: heat map, Pareto plot, and bound, posterior and error together."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from egocap.files import make_folder, write_atomically
from egocap.posterior.figures import write_pictures
from egocap_eval.rig_design.rig_report import PAPERS, RigReport


def write_rig_page(path: Path, report: RigReport) -> None:
    """All pictures of a study and its recommendation as one HTML file."""
    drawn = [("Pareto", draw_pareto(report))]
    if sum(len(s.values) > 1 for s in report.sweeps) > 1:
        drawn.insert(0, ("Heat map", draw_heat_map(report)))
    if report.tracked:
        drawn.append(("Bound, posterior and error", draw_together(report)))
    write_pictures(path, "Rig design", drawn, facts=report.recommendation())


def save_together(path: Path, report: RigReport) -> None:
    """Bound, posterior and error as a PNG file, whole or not at all."""
    file = io.BytesIO()
    draw_together(report).savefig(file, format="png", dpi=110)
    make_folder(path.parent)
    write_atomically(path, file.getvalue())


def draw_heat_map(report: RigReport) -> Any:
    """Bound over the first two sweeps of several values; the least over the others."""
    figure, axes = _axes()
    x, y = [s for s in report.sweeps if len(s.values) > 1][:2]
    grid = np.full((len(y.values), len(x.values)), np.inf)
    for c in report.candidates:
        at = y.values.index(c.measures[y.name]), x.values.index(c.measures[x.name])
        grid[at] = min(grid[at], c.bound_mm)
    mesh = axes.pcolormesh(x.values, y.values, grid, shading="nearest", cmap="viridis_r")
    figure.colorbar(mesh, label="bound, mm")
    axes.plot(report.best.measures[x.name], report.best.measures[y.name], "w*", ms=14, mec="k")
    axes.set_xlabel(_label(x.name))
    axes.set_ylabel(_label(y.name))
    return figure


def draw_pareto(report: RigReport) -> Any:
    """Bound against baseline; the front of rigs that no narrower one beats."""
    figure, axes = _axes()
    shade = [c.seen_any for c in report.candidates]
    dots = axes.scatter([c.measures["baseline"] for c in report.candidates],
                        [c.bound_mm for c in report.candidates], c=shade, s=16)  # fmt: skip
    figure.colorbar(dots, label="share of joints seen by a camera")
    front = report.pareto()
    axes.step([c.measures["baseline"] for c in front], [c.bound_mm for c in front],
              where="post", color="#b91c1c", label="no narrower rig is better")  # fmt: skip
    axes.axvspan(*PAPERS, color="#9ca3af", alpha=0.3, label="the paper's choice")
    axes.set_xlabel(_label("baseline"))
    axes.set_ylabel("bound of a frame, mm (root mean square)")
    axes.legend()
    return figure


def draw_together(report: RigReport) -> Any:
    """Tracked candidates along the first sweep: both bounds, the posterior's spread, the errors."""
    figure, axes = _axes()
    sweep = report.sweeps[0]
    x = [c.measures[sweep.name] for c in report.tracked]
    axes.plot(x, [c.bound_mm for c in report.tracked], "o-", label="bound, a frame alone")
    for key, label, style in (
        ("smoothed_mm", "bound, the whole motion (the tracker's weaker prior)", "s-"),
        ("posterior_mm", "posterior's spread (Laplace), a frame alone", "^--"),
        ("mode_mm", "posterior mode's error", "v--"),
        ("tracked_mm", "tracker's error", "D-"),
        ("smoothed_seen_mm", "bound, the whole motion, seen joints", "s:"),
        ("tracked_seen_mm", "tracker's error, seen joints", "D:"),
    ):
        values = [c.tracked.rms_mm[key] for c in report.tracked if c.tracked]
        axes.plot(x, values, style, label=label)
    if sweep.name == "baseline":
        axes.axvspan(*PAPERS, color="#9ca3af", alpha=0.3, label="the paper's choice")
    axes.set_xlabel(_label(sweep.name))
    axes.set_ylabel("root mean square, mm")
    axes.set_ylim(0, None)
    axes.legend(fontsize=7, ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.14))
    return figure


def _axes() -> Any:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.8), layout="constrained")
    return figure, figure.subplots()


def _label(name: str) -> str:
    unit = "degrees" if name in ("pitch", "toe_out", "fov") else "metres"
    return f"{name.replace('_', '-').replace('fov', 'field of view')}, {unit}"
