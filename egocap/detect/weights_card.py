"""What a weights file says of itself: network, calibration, scores, and stages of its training."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from egocap.detect.weights import SHIPPED, Weights, open_weights, shipped_file


def shipped_weights() -> list[Weights]:
    """All shipped weights, the default ones first. Raises FileError, MachineError."""
    folder = shipped_file().parent
    names = sorted(path.stem for path in folder.glob("*.safetensors"))
    names.sort(key=lambda name: name != SHIPPED)
    return [open_weights() if n == SHIPPED else open_weights(shipped_file(n)) for n in names]


def card(weights: Weights) -> dict[str, Any]:
    """JSON-ready description. Raises FileError for damaged tensors."""
    tensors = weights.stored()
    view = weights.view
    return {
        "name": weights.name, "file": str(weights.path), "sha256": weights.sha256,
        "bytes": weights.path.stat().st_size, "network": weights.config["name"],
        "parameters": sum(t.size for t in tensors.values()),
        "view": [view.width, view.height], "calibration": weights.calibration.to_dict(),
        "scores": weights.training.get("scores"), "stages": list(_stages(weights.training)),
    }  # fmt: skip


def _stages(training: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """The stages of a training record, the last one first."""
    while training:
        yield {key: training.get(key) for key in ("command", "steps", "seconds", "views",
                                                  "averaged_with", "adapted_from")
               if training.get(key) is not None}  # fmt: skip
        start = training.get("start")
        training = start.get("training", {}) if isinstance(start, Mapping) else {}
        if not isinstance(training, Mapping):
            return
