"""Picture of the detector's scores: PCK by distance (the paper's Figure 7), and calibration."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

ARMS, LEGS = ("shoulder", "elbow", "wrist", "hand"), ("hip", "knee", "ankle", "foot")


def draw(result: Mapping[str, Any], path: Path) -> None:
    """Draw the result of `detection.detector` as PNG or SVG, by the suffix of `path`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 8), layout="constrained")
    arms, legs, spread, confidence = figure.subplots(2, 2).flat
    for axes, groups, title in ((arms, ARMS, "arms"), (legs, LEGS, "legs")):
        for name in groups:
            curve = result["visible"]["group_curves"][name]
            paper = result["paper"].get(name)
            label = name if paper is None else f"{name} (paper {paper} at 20 px)"
            axes.plot(range(len(curve)), curve, label=label)
        axes.set(xlabel="distance, pixels at 640 x 512", ylabel="PCK of visible joints, %",
                 title=title, ylim=(0, 100), xlim=(0, 20))  # fmt: skip
        axes.grid(alpha=0.3)
        axes.legend()
    for kind, found in result["spread"].items():
        pairs = [(float(level), share) for level, share in found["coverage"].items()]
        if found["joints"]:
            spread.plot(*zip(*pairs, strict=True), marker="o", label=f"{kind} joints")
    spread.set(xlabel="share of a Gaussian within the circle", ylabel="share of errors",
               title="does the spread match the error?")  # fmt: skip
    rows = result["confidence"]["reliability"]
    if rows:
        confidence.plot([r[0] for r in rows], [r[1] for r in rows], marker="o")
    confidence.set(xlabel="confidence", ylabel="share of joints seen",
                   title="is confidence a probability?")  # fmt: skip
    for axes in (spread, confidence):
        axes.plot([0, 1], [0, 1], color="grey", linewidth=0.8)
        axes.grid(alpha=0.3)
    spread.legend()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
