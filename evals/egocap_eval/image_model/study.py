"""Studies of the volumetric image model: is it exact, and how well does it find poses.

    python -m egocap_eval.image_model.study SEQ... --live SEQ... --out RESULT.json
    python -m egocap_eval.image_model.plots RESULT.json OUT.png

SEQ are simulated sequences, of several people and motions; those of --live are followed by colour
alone. Colours are learned in five frames of a sequence at the true pose, as personalisation would
(live: in the first); poses are searched without the truth, which only judges them.
`tools/measure-image-model.sh` makes the sequences of the committed result, and all of it.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from egocap.body.gaussians import GaussianBody
from egocap.body.proportions import Proportions
from egocap.errors import EgocapError
from egocap_eval.image_model.basin import (
    basin_study,
    detection_study,
    live_study,
    valley_study,
)
from egocap_eval.image_model.exactness import (
    gradient_study,
    occlusion_study,
    quadrature_study,
    stochastic_study,
)
from egocap_eval.image_model.scene import Scene

CURVES = ("occlusion", "valleys")
"""Parts of the result that are for plots."""


def study(words: argparse.Namespace) -> dict[str, Any]:
    """All studies' numbers."""
    rng = np.random.default_rng(0)
    scenes = [Scene(folder) for folder in words.sequences]
    rig = scenes[0].sequence.rig
    body = GaussianBody.from_proportions(Proportions.from_lengths())
    coloured = body.with_colour(rng.uniform(0.05, 0.95, (len(body.parts), 3)))
    return {
        "quadrature": quadrature_study(rig, rng),
        "gradients": gradient_study(coloured, rig, rng),
        "occlusion": occlusion_study(body, rig),
        "stochastic": stochastic_study(scenes[0], rng),
        "valleys": valley_study(scenes[:3]),
        "live": {folder.name: live_study(folder, words.live_frames) for folder in words.live},
        "beside_detections": detection_study(scenes, words.frames, rng),
        "basin": basin_study(scenes, words.trials, rng),
    }


def main() -> int:
    """Run all studies; print and write their numbers; the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("sequences", type=Path, nargs="+")
    parser.add_argument("--live", type=Path, nargs="*", default=[])
    parser.add_argument("--live-frames", type=int, default=250)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--trials", type=int, default=8, help="of every kind, a sequence")
    parser.add_argument("--frames", type=int, default=8, help="to compare, of every sequence")
    words = parser.parse_args()
    try:
        result = study(words)
    except EgocapError as error:
        print(f"image_model: {error}", file=sys.stderr)
        return error.exit_code
    print(json.dumps({k: v for k, v in result.items() if k not in CURVES}, indent=1))
    if words.out:
        from egocap_eval.harness.result_file import save_result

        names, live = ([folder.name for folder in f] for f in (words.sequences, words.live))
        counts = ["--trials", str(words.trials), "--frames", str(words.frames)]
        command = [
            "python",
            "-m",
            "egocap_eval.image_model.study",
            *names,
            "--live",
            *live,
            *counts,
        ]
        save_result(words.out, result, [*command, "--out", str(words.out)])
    return 0


if __name__ == "__main__":
    sys.exit(main())
