"""Show cameras on booms larger to the detector than its training did.

    python -m egocap_eval.detection.magnify WEIGHTS BOOM_FOCAL OUT

BOOM_FOCAL is `ViewSpec.boom_focal`, in pixels per radian; the tensors stay as they are. The record
of the training keeps the view of the training. Calibrate the weights afterwards.
Source: Touvron et al. 2019, "Fixing the train-test resolution discrepancy".
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

from egocap.detect.weights import open_weights, with_calibration


def magnify(weights: Path, boom_focal: float, out: Path) -> None:
    """Write the weights with another focal length. Raises InputError for one of 0 or less."""
    old = open_weights(weights)
    view = replace(old.view, boom_focal=boom_focal)
    new = replace(old, view=view, config={**old.config, "view": view.to_dict()})
    account = {k: v for k, v in old.training.items() if k != "calibration"}
    account.setdefault("trained_view", old.view.to_dict())  # stays that of the training
    with_calibration(new, old.calibration, account, out)


def main() -> None:
    """Change the view of the weights named on the command line."""
    weights, boom_focal, out = sys.argv[1:]
    magnify(Path(weights), float(boom_focal), Path(out))


if __name__ == "__main__":
    main()
