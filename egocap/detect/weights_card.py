"""What a weights file says of itself: network, calibration, scores, and stages of its training."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Any

from pydantic import ConfigDict, Field

from egocap.detect.weights import SHIPPED, Weights, open_weights, shipped_file
from egocap.schema import Number, Strict, checked


def shipped_weights() -> list[Weights]:
    """All shipped weights, the default ones first. Raises FileError, MachineError."""
    folder = shipped_file().parent
    names = sorted(path.stem for path in folder.glob("*.safetensors"))
    names.sort(key=lambda name: name != SHIPPED)
    return [open_weights() if n == SHIPPED else open_weights(shipped_file(n)) for n in names]


def card(weights: Weights) -> dict[str, Any]:
    """JSON-ready description. Raises FileError for damaged tensors or a damaged training record."""
    tensors, stages = weights.stored(), list(_stages(weights))
    view = weights.view
    return {
        "name": weights.name, "file": str(weights.path), "sha256": weights.sha256,
        "bytes": weights.path.stat().st_size, "network": weights.config["name"],
        "parameters": sum(t.size for t in tensors.values()),
        "view": [view.width, view.height], "calibration": weights.calibration.to_dict(),
        "scores": stages[0].scores if stages else None,
        "stages": [stage.model_dump(include=_SHOWN, exclude_none=True) for stage in stages],
    }  # fmt: skip


Score = Annotated[float, Field(strict=True, allow_inf_nan=True)]
"""NaN where the held-out views show no such joint."""


class _Record(Strict):
    """What is read of a record with more keys."""

    model_config = ConfigDict(extra="ignore")


class _Origin(_Record):
    name: str
    sha256: str | None = None
    share: Number | None = None
    training: dict[str, Any] | None = None


class _Stage(_Record):
    command: str | None = None
    steps: int | None = None
    seconds: Number | None = None
    views: int | None = None
    scores: dict[str, Score] | None = None
    averaged_with: _Origin | None = None
    adapted_from: _Origin | None = None
    start: _Origin | None = None


_SHOWN = {"command", "steps", "seconds", "views", "averaged_with", "adapted_from"}


def _stages(weights: Weights) -> Iterator[_Stage]:
    """The stages of the training record, the last one first."""
    training: Mapping[str, Any] | None = weights.training
    key = "training"
    while training:
        stage = checked(_Stage, training, weights.path, key)
        yield stage
        training = stage.start.training if stage.start else None
        key += ".start.training"
