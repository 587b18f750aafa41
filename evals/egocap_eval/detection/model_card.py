"""Model card of detector weights.

    python -m egocap_eval.detection.model_card WEIGHTS RESULT.json CARD.md [RIG=RESULT.json ...]

Every number is read from the metadata of the weights and the results of `egocap-eval detector`, the
first on the held-out set, the others on other rigs.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from egocap.detect import weights_card
from egocap.detect.weights import Weights, open_weights
from egocap.errors import FileError
from egocap.evaluation.table import Table, number
from egocap_eval.detection.detector import tables
from egocap_eval.harness.result_file import load_result, write_text

LIMITS = (
    "Trained on simulated footage alone; nothing here says how it does on real cameras.",
    "One wearer in the picture's middle is assumed: the body that hangs below the camera. Other "
    "people close by are the commonest cause of gross errors, next to limbs that cross.",
    "Hidden joints are guessed. Their spread is wider and their confidence low, but a guess is no "
    "measurement.",
    "Cameras on the head's left are seen as they are, on its right mirrored; a camera on the "
    "forehead's middle counts as left.",
    "Beside the face, cheeks and chest hide most of the body: hips, knees and feet of people with "
    "glasses are seen by few pixels, if at all.",
    "Legs far below the head are a few pixels of the canonical view: larger pictures do not help.",
)
"""Limitations of the weights."""


def card(
    weights: Weights, record: Mapping[str, Any], others: Mapping[str, Mapping[str, Any]] = {}
) -> str:
    """The card as Markdown; `others` are results by rig. FileError for those of other weights."""
    for each in (record, *others.values()):
        scored = each.get("config", {}).get("weights")
        if scored != weights.sha256:
            raise FileError(weights.path, "the result is of other weights", valid=str(scored))
    view, result = weights.view, record["result"]
    parts = [
        f"# Detector weights `{weights.name}`",
        f"sha256 `{weights.sha256}`, {weights.path.stat().st_size / 1e6:.1f} MB. Finds the 18 "
        "labels of `body.labels` in fisheye views of a head-worn rig, in a canonical view of "
        f"{view.width} x {view.height} pixels (`egocap.detect.canonical_view`)."
        + _magnified(weights),
        "## How it was made",
        "Stages of training, the last one first; all their settings are in the file's metadata.",
        "\n".join(map(_stage, weights_card.card(weights)["stages"])),
        "Calibration (`egocap calibrate-detector`), on people with seeds of their own who play "
        "training and validation clips (tools/release-detector.sh):",
        _listed(weights.training.get("calibration", {"none": "as trained"})),
        "## How good it is",
        f"On {result['frames']} validation frames, of people, places and clips unseen in training; "
        "weights are chosen by such scores and by tracked validation clips "
        f"(`{record['command']}`, commit `{record['commit']}`):",
        *(table.markdown() for table in tables(result)),
        *([_other_rigs(others).markdown()] if others else []),
        "## What it cannot do",
        "\n".join(f"- {limit}" for limit in LIMITS),
    ]
    return "\n\n".join(parts) + "\n"


def _magnified(weights: Weights) -> str:
    trained, view = weights.training.get("trained_view"), weights.view
    if trained is None or view.boom_focal is None:
        return ""
    share = view.boom_focal / trained["focal"]
    return f" Cameras on booms are shown {share:.2f} times as large as they were in training."


def _other_rigs(records: Mapping[str, Mapping[str, Any]]) -> Table:
    """Accuracy on other rigs, one a row."""
    rows = []
    for rig, record in records.items():
        result = record["result"]
        scores = (result[kind][m] for kind in ("visible", "in_view") for m in ("pck20", "auc20"))
        rows.append((rig, str(result["frames"]), *map(number, scores)))
    header = ("rig", "frames", "PCK", "AUC", "PCK in view", "AUC")
    return Table("Other rigs (evals/rig-families.toml)", header, tuple(rows))


def _stage(stage: Mapping[str, Any]) -> str:
    counts = [f"{stage[key]} {key}" for key in ("steps", "views") if key in stage]
    if "seconds" in stage:
        counts.append(f"{stage['seconds'] / 60.0:.0f} min")
    for key in ("averaged_with", "adapted_from"):
        if key in stage:
            counts.append(f"{key.replace('_', ' ')} {stage[key]['name']}")
    return f"- `{stage.get('command', 'unknown')}`" + (f": {', '.join(counts)}" if counts else "")


def _listed(values: Mapping[str, Any]) -> str:
    return "\n".join(
        f"- {key.replace('_', ' ')}: {v if isinstance(v, str) else json.dumps(v)}"
        for key, v in sorted(values.items())
    )


def main() -> None:
    """Write the card of the weights and results named on the command line."""
    weights, result, out, *named = sys.argv[1:]
    others = {rig: load_result(path) for rig, _, path in (pair.partition("=") for pair in named)}
    write_text(Path(out), card(open_weights(weights), load_result(result), others))


if __name__ == "__main__":
    main()
