"""Average two files of detector weights: fine-tuned weights and those they were trained from.

    python -m egocap_eval.detection.average TRAINED START SHARE OUT

SHARE is that of TRAINED, 0 to 1. The average keeps most of what training gained on new footage and
most of the accuracy on the old. Calibrate it afterwards (`egocap calibrate-detector`).
Source: Wortsman et al. 2022, "Robust fine-tuning of zero-shot models".
"""

from __future__ import annotations

import sys
from pathlib import Path

from egocap.detect.weights import open_weights, save_weights
from egocap.errors import InputError


def average(trained: Path, start: Path, share: float, out: Path) -> None:
    """Write share * trained + (1 - share) * start. Raises InputError for other networks."""
    if not 0.0 <= share <= 1.0:
        raise InputError(f"a share of {share}", valid="0 to 1")
    new, old = open_weights(trained), open_weights(start)
    network = new.network()
    mine, theirs = network.state_dict(), old.network().state_dict()
    if {k: v.shape for k, v in mine.items()} != {k: v.shape for k, v in theirs.items()}:
        raise InputError(f"{trained} and {start} are of different networks", valid="the same one")
    network.load_state_dict({
        k: share * v + (1.0 - share) * theirs[k] if v.is_floating_point() else v
        for k, v in mine.items()
    })  # fmt: skip
    network.eval()
    account = {k: v for k, v in new.training.items() if k != "calibration"}
    account["averaged_with"] = {"name": old.name, "sha256": old.sha256, "share": 1.0 - share}
    save_weights(out, network, account)


def main() -> None:
    """Average the weights named on the command line."""
    trained, start, share, out = sys.argv[1:]
    average(Path(trained), Path(start), float(share), Path(out))


if __name__ == "__main__":
    main()
