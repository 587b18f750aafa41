"""Studies of the volumetric image model: exactness, and basin of attraction of the true pose.

Colours are learned in five frames of a sequence at the true pose, as personalisation would; in
sequences tracked online, in the first frame. The solver does not use the truth.
`egocap-eval refresh image_model` makes the sequences of the committed result, and the result.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import Positional, arg

from egocap.body.gaussians import GaussianBody
from egocap.body.proportions import Proportions
from egocap.evaluation.table import Table, number
from egocap_eval.harness.footage import content_hashes
from egocap_eval.harness.study import Outcome
from egocap_eval.image_model.basin import (
    basin_study,
    detection_study,
    live_study,
    profile_study,
)
from egocap_eval.image_model.exactness import (
    gradient_study,
    occlusion_study,
    quadrature_study,
    stochastic_study,
)
from egocap_eval.image_model.plots import draw
from egocap_eval.image_model.scene import Scene


def study(
    sequences: Positional[Annotated[tuple[Path, ...], arg(metavar="SEQ")]],
    /,
    live: tuple[Path, ...] = (),
    live_frames: int = 600,
    trials: int = 8,
    frames: int = 8,
    plot: Path | None = None,
) -> Outcome:
    """Measure the accuracy of the image model and its basin of attraction.

    Args:
        sequences: Simulated sequences of several people and motions.
        live: Simulated sequences in which the upper body is tracked without a detector.
        live_frames: Frames of each of these.
        trials: Perturbed poses of every kind per sequence.
        frames: Frames to solve with and without colour, of every sequence.
        plot: Figure to write, png or svg; a second one gets the suffix -angles.
    """
    rng = np.random.default_rng(0)
    scenes = [Scene(folder) for folder in sequences]
    rig = scenes[0].sequence.rig
    body = GaussianBody.from_proportions(Proportions.from_lengths())
    coloured = body.with_colour(rng.uniform(0.05, 0.95, (len(body.parts), 3)))
    result = {
        "quadrature": quadrature_study(rig, rng),
        "gradients": gradient_study(coloured, rig, rng),
        "occlusion": occlusion_study(body, rig),
        "stochastic": stochastic_study(scenes[0], rng),
        "valleys": profile_study(scenes[:3]),
        "live": {folder.name: live_study(folder, live_frames) for folder in live},
        "beside_detections": detection_study(scenes, frames, rng),
        "basin": basin_study(scenes, trials, rng),
    }
    if plot is not None:
        draw(result, plot)
    return Outcome(result, _tables(result), config=content_hashes(s.sequence for s in scenes))


def _tables(result: dict[str, Any]) -> list[Table]:
    basin, live = result["basin"], result["live"]
    sizes = next(iter(basin.values()))
    shares = tuple(
        (name, *(number(100 * entry[size]["share_under_30_mm"], 0) for size in sizes))
        for name, entry in basin.items()
    )
    quadrature = tuple(
        (name, f"{entry['samples_9']['relative']:.1e}", f"{entry['cells_20mm']['relative']:.1e}")
        for name, entry in result["quadrature"].items()
    )
    means = tuple(
        (name, *(number(value) for value in entry["mean"].values()))
        for name, entry in result["beside_detections"].items()
    )
    columns = next(iter(result["beside_detections"].values()))["mean"]
    tables = [
        Table("Relative error of visibility", ("rays", "9 samples", "cells of 2 cm"), quadrature),
        Table("Perturbed poses back under 30 mm, %", ("", *(s.replace("_", " ") for s in sizes)),
              shares),
        Table("Mean error, mm", ("detections", *(c.replace("_", " ") for c in columns)), means),
    ]  # fmt: skip
    if live:
        header = ("sequence", "mean mm", "median mm")
        rows = tuple((n, number(e["mean_mm"]), number(e["median_mm"])) for n, e in live.items())
        tables.append(Table("Upper body without a detector", header, rows))
    return tables
