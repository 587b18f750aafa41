"""Files of a training run, written atomically: checkpoint.pt and final.safetensors."""

from __future__ import annotations

import json
import pickle
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from egocap.errors import FileError
from egocap.files import replacing
from egocap.schema import parsed

if TYPE_CHECKING:
    from egocap.detect.network import DetectorNetwork
    from egocap.detect.train.validation import Scores

CHECKPOINT, FINAL = "checkpoint.pt", "final.safetensors"


@dataclass
class RunState:
    """Progress of a run, stored in its checkpoint."""

    step: int = 0
    seconds: float = 0.0  # spent in training steps, over all sessions
    views: int = 0  # trained on, over all processes


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """State dictionaries of a resumable run."""

    network: dict[str, Any]
    average: dict[str, Any]
    optimiser: dict[str, Any]
    state: dict[str, Any]
    config: dict[str, Any]  # of the network


def save_checkpoint(
    folder: Path,
    network: DetectorNetwork,
    average: DetectorNetwork,
    optimiser: torch.optim.Optimizer,
    state: dict[str, Any],
) -> Path:
    """Replace the folder's checkpoint atomically."""
    path = folder / CHECKPOINT
    content = {
        "network": network.state_dict(), "average": average.state_dict(),
        "optimiser": optimiser.state_dict(), "state": state,
        "config": json.dumps(network.config.to_dict()),
    }  # fmt: skip
    with replacing(path) as temporary:
        torch.save(content, temporary)
    return path


def load_checkpoint(folder: Path, device: torch.device | str = "cpu") -> Checkpoint | None:
    """The folder's checkpoint; None when there is none. Raises FileError for a damaged one."""
    path = folder / CHECKPOINT
    if not path.exists():
        return None
    with _whole(path):
        found = torch.load(path, map_location=device, weights_only=True)
        network, average, optimiser, state = (
            dict(found[name]) for name in ("network", "average", "optimiser", "state")
        )
        config = parsed(found["config"], path, key="config")
        return Checkpoint(network, average, optimiser, state, config)


def restore_checkpoint(
    folder: Path,
    network: DetectorNetwork,
    average: DetectorNetwork,
    optimiser: torch.optim.Optimizer,
    device: torch.device | str = "cpu",
) -> RunState | None:
    """Load the folder's checkpoint into a run; None when there is none. Raises FileError."""
    found = load_checkpoint(folder, device)
    if found is None:
        return None
    with _whole(folder / CHECKPOINT):
        network.load_state_dict(found.network)
        average.load_state_dict(found.average)
        optimiser.load_state_dict(found.optimiser)
        state = RunState(**found.state)
        if not all(value >= 0 for value in (state.step, state.seconds, state.views)):
            raise ValueError(f"progress {state}")
        return state


@contextmanager
def _whole(path: Path) -> Iterator[None]:
    """Raise FileError for what a damaged checkpoint makes torch and us raise."""
    try:
        yield
    except (RuntimeError, pickle.UnpicklingError, LookupError, TypeError, ValueError, EOFError,
            AttributeError, AssertionError, OSError) as error:  # fmt: skip
        first = str(error).splitlines()[0] if str(error) else type(error).__name__
        valid = "one written by egocap train; delete it to start again"
        raise FileError(path, f"not a whole checkpoint: {first}", valid=valid) from None


def save_run_weights(folder: Path, network: DetectorNetwork, scores: Scores | None) -> Path:
    """Write final.safetensors: weights, the network's configuration and its scores."""
    from safetensors.torch import save_file

    path = folder / FINAL
    metadata = {"config": json.dumps(network.config.to_dict())}
    if scores is not None:
        metadata["scores"] = json.dumps(scores.to_dict())
    tensors = {k: v.detach().cpu().contiguous().clone() for k, v in network.state_dict().items()}
    with replacing(path) as temporary:
        save_file(tensors, temporary, metadata)
    return path


def load_run_weights(path: Path) -> dict[str, torch.Tensor]:
    """Read final.safetensors, or the averaged weights of checkpoint.pt, as initial weights.

    Raises FileError.
    """
    if path.is_dir():
        path = path / FINAL if (path / FINAL).exists() else path / CHECKPOINT
    if not path.exists():
        raise FileError(path, "no such file", valid=f"a run's folder, {FINAL} or {CHECKPOINT}")
    if path.suffix == ".pt":
        found = load_checkpoint(path.parent)
        assert found is not None
        return found.average
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    try:
        return load_file(path)
    except (SafetensorError, OSError, KeyError, TypeError, ValueError) as error:
        raise FileError(path, f"not a whole safetensors file: {error}") from None
