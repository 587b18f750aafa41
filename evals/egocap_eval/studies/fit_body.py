"""Accuracy of fitted bone lengths: per bone, and by how well the fit determines it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import Positional, arg

from egocap.body.skeleton import POINTS
from egocap.data.sequence import Sequence
from egocap.detect.sources import detections_from
from egocap.evaluation.table import Table, number
from egocap.fitting.fit_body import BodyFit, first_seconds, fit_body
from egocap_eval.harness.study import Outcome


def study(
    sequences: Positional[Annotated[tuple[Path, ...], arg(metavar="SEQ")]],
    /,
    detections: Annotated[str, arg(metavar="SOURCE")] = "simulated:2",
    seconds: float = 20.0,
    with_height: bool = False,
) -> Outcome:
    """Fit a body to each sequence's detections and compare its bones with the true ones.

    Args:
        sequences: Simulated sequences.
        detections: Source of detections, as for `egocap track`.
        seconds: Length of each sequence that is used.
        with_height: Give the fit each person's height.
    """
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for folder in sequences:
        sequence = Sequence(folder)
        height = person_height(folder) if with_height else None
        observed = detections_from(sequence, detections, 0)
        fit = fit_body(first_seconds(observed, seconds), sequence.rig, height)
        found[folder.name] = bone_errors(fit, sequence.body.bone_lengths)
    result = {"summary": summary(found), "bones": list(POINTS), "sequences": found}
    return Outcome(result, [summary_table(result["summary"])])


def person_height(folder: Path) -> float:
    """Height in metres of the simulated person of a sequence."""
    return float(json.loads((folder / "person.json").read_text(encoding="utf-8"))["height_m"])


def bone_errors(fit: BodyFit, truth: dict[str, float]) -> dict[str, dict[str, Any]]:
    """Error in % of every bone, left and right together, with its report."""
    report = fit.report()
    return {
        name.removeprefix("left_"): {
            "error_percent": round(100.0 * (float(line["length_m"]) / truth[name] - 1.0), 2)
        }
        | line
        for name, line in report.items()
        if not name.startswith("right_")
    }


def summary(sequences: dict[str, dict[str, dict[str, Any]]]) -> dict[str, Any]:
    """Errors over all sequences by rating, and in stated standard deviations."""
    lines = [line for bones in sequences.values() for line in bones.values()]
    result: dict[str, Any] = {}
    for verdict in ("well", "badly", "prior"):
        errors = np.array([abs(x["error_percent"]) for x in lines if x["determined"] == verdict])
        if len(errors):
            result[verdict] = {
                "bones": len(errors),
                "mean_percent": round(float(errors.mean()), 2),
                "worst_percent": round(float(errors.max()), 2),
                "share_within_3_percent": round(float((errors <= 3.0).mean()), 3),
            }
    z = np.array([x["error_percent"] / max(x["std_percent"], 1e-6) for x in lines])
    result["error_over_stated_std_rms"] = round(float(np.sqrt((z**2).mean())), 2)
    return result


def summary_table(found: dict[str, Any]) -> Table:
    """Errors by the fit's own rating of each bone."""
    header = ("bones", "number", "mean error %", "worst %", "within 3 %")
    rows = tuple(
        (verdict, str(line["bones"]), number(line["mean_percent"]), number(line["worst_percent"]),
         number(100 * line["share_within_3_percent"], 0))
        for verdict, line in found.items() if isinstance(line, dict)
    )  # fmt: skip
    return Table("fitted bones, by how well the fit determines them", header, rows)
