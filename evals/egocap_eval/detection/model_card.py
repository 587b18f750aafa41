"""Model card of detector weights.

    python -m egocap_eval.detection.model_card WEIGHTS RESULT.json CARD.md

Every number is read from the metadata of the weights and the result of `egocap-eval detector`.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from egocap.detect.weights import Weights, open_weights
from egocap.errors import FileError
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
    "Legs far below the head are a few pixels of the canonical view: larger pictures do not help.",
)
"""Limitations of the weights."""


def card(weights: Weights, record: Mapping[str, Any]) -> str:
    """The card as Markdown. Raises FileError if the result is of other weights."""
    config = record.get("config", {})
    scored = config.get("weights")
    if scored != weights.sha256:
        raise FileError(weights.path, "the result is of other weights", valid=str(scored))
    view, result = weights.view, record["result"]
    training = {k: v for k, v in weights.training.items() if k != "calibration"}
    parts = [
        f"# Detector weights `{weights.name}`",
        f"sha256 `{weights.sha256}`, {weights.path.stat().st_size / 1e6:.1f} MB. Finds the 18 "
        "labels of `body.labels` in fisheye views of a head-worn rig, in a canonical view of "
        f"{view.width} x {view.height} pixels (`egocap.detect.canonical_view`).",
        "## How it was made",
        _listed(training),
        "Calibration (`egocap calibrate-detector`), on footage it was not trained on:",
        _listed(weights.training.get("calibration", {"none": "as trained"})),
        "## How good it is",
        f"On {result['frames']} stereo frames that nobody trained or tuned on "
        f"(`{record['command']}`, commit `{record['commit']}`):",
        *(table.markdown() for table in tables(result)),
        "## What it cannot do",
        "\n".join(f"- {limit}" for limit in LIMITS),
    ]
    return "\n\n".join(parts) + "\n"


def _listed(values: Mapping[str, Any]) -> str:
    return "\n".join(
        f"- {key.replace('_', ' ')}: {v if isinstance(v, str) else json.dumps(v)}"
        for key, v in sorted(values.items())
    )


def main() -> None:
    """Write the card of the weights and result named on the command line."""
    weights, result, out = sys.argv[1:]
    write_text(Path(out), card(open_weights(weights), load_result(result)))


if __name__ == "__main__":
    main()
