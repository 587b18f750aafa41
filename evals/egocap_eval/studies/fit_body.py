"""How well bone lengths come out of detections.

    python -m egocap_eval.studies.fit_body SEQ... --out FILE.json

SEQ are simulated sequences; each is fitted from its detections alone, and the person's true
proportions judge the result, bone by bone and by what the fit says of itself.
"""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from pathlib import Path
from typing import Any

import numpy as np

from egocap.body.skeleton import POINTS
from egocap.data.sequence import Sequence
from egocap.detect.sources import detections_from
from egocap.fitting.fit_body import BodyFit, first_seconds, fit_body


def bone_errors(fit: BodyFit, truth: dict[str, float]) -> dict[str, dict[str, Any]]:
    """Error in % of every bone, left and right being alike, with its report."""
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
    """Errors over all sequences by verdict, and in stated standard deviations."""
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


def main() -> None:
    """Fit, judge, print and write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("sequences", type=Path, nargs="+")
    parser.add_argument("--detections", default="simulated:2")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--with-height", action="store_true", help="state each person's height")
    parser.add_argument("--out", type=Path)
    words = parser.parse_args()
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for folder in words.sequences:
        sequence = Sequence(folder)
        person = json.loads((folder / "person.json").read_text(encoding="utf-8"))
        height = float(person["height_m"]) if words.with_height else None
        detections = detections_from(sequence, words.detections, 0)
        fit = fit_body(first_seconds(detections, words.seconds), sequence.rig, height)
        found[folder.name] = bone_errors(fit, sequence.proportions.bone_lengths)
    result = {"summary": summary(found), "bones": list(POINTS), "sequences": found}
    print(json.dumps(result["summary"], indent=1))
    if words.out:
        from egocap_eval.harness.result_file import save_result

        save_result(
            words.out,
            result,
            shlex.join(["python", "-m", "egocap_eval.studies.fit_body", *sys.argv[1:]]),
        )


if __name__ == "__main__":
    main()
