"""One training run: find the data, split it, train, and export the weights."""

from __future__ import annotations

import atexit
import json
import logging
import os
import shlex
import sys
from collections.abc import Sequence
from dataclasses import asdict
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from egocap.data.dataset import find_sequences
from egocap.detect.network import NetworkConfig, config_named
from egocap.detect.train.checkpoint import CHECKPOINT, FINAL, load_run_weights
from egocap.detect.train.config import RunConfig, TrainingConfig
from egocap.detect.train.examples import ViewStore, build_store, mixed
from egocap.detect.train.trainer import Outcome, Trainer
from egocap.detect.weights import open_weights, save_weights
from egocap.errors import FileError, InputError
from egocap.files import make_folder, write_json
from egocap.schema import read_json

if TYPE_CHECKING:
    import torch

log = logging.getLogger(__name__)

RUN = "run.json"

_FEW = 5  # held-out sequences
_SCORES = {
    "pck": ("visible labels within 20 px", "%"), "auc": ("mean over thresholds to 20 px", "%"),
    "error_px": ("mean error of visible labels", "px"), "median_px": ("median error", "px"),
    "pck_in_view": ("labels in view, occluded too, within 20 px", "%"),
    "pck_wrist": ("wrists within 20 px", "%"), "pck_ankle": ("ankles within 20 px", "%"),
}  # fmt: skip
"""Scores shown, in words and with their unit."""


def train_detector(
    request: RunConfig, training: TrainingConfig, command: Sequence[str] | None = None
) -> Outcome:
    """Train a detector and write `out`/detector.safetensors.

    `command` is recorded with the weights; None: that of the process. Raises InputError or
    FileError for unusable data, weights or run folder.
    """
    network = config_named(request.config)
    start = prepare_run(request, training)
    kept, held_out = _stores(request, network)
    log.info("%d views to train on, %d held out", len(kept), len(held_out) if held_out else 0)
    trainer = Trainer(
        network, training, kept, held_out, request.out, start, _backgrounds(request, network)
    )
    if request.resume and trainer.resume():
        log.info("resuming from step %d", trainer.state.step)
    finished = trainer.progress() >= 1.0 and weights_path(request.out).exists()
    outcome = trainer.run()
    if finished:
        log.info("finished before; its weights stay as they are")
    elif outcome.weights is not None:
        words = ["egocap", *sys.argv[1:]] if command is None else command
        account = _account(request, training, kept, outcome)
        account["command"] = shlex.join(map(_without_folder, words))
        save_weights(weights_path(request.out), trainer.average, account)
    return outcome


def prepare_run(request: RunConfig, training: TrainingConfig) -> dict[str, torch.Tensor] | None:
    """Make or check the folder of a run, and read the initial weights, if any.

    Raises InputError or FileError if the folder holds another run or the weights do not fit.
    """
    network = config_named(request.config)
    start = _start(request, network)
    _prepare(request, training, network)
    return start


def summary(request: RunConfig, outcome: Outcome) -> dict[str, Any]:
    """Summary of a run, JSON-ready."""
    return {
        "finished": outcome.finished, "steps": outcome.state.step, "views": outcome.state.views,
        "seconds": round(outcome.state.seconds, 1),
        "weights": str(weights_path(request.out)) if outcome.weights else None,
        "scores": None if outcome.scores is None else outcome.scores.to_dict(),
        "start_scores": None if outcome.start_scores is None else outcome.start_scores.to_dict(),
        "held_out": dict(zip(("sequences", "views"), outcome.held_out, strict=True)),
    }  # fmt: skip


def summary_text(request: RunConfig, outcome: Outcome) -> str:
    """Summary of a run in one or two lines."""
    state = outcome.state
    if not outcome.finished:
        return f"{request.out}: interrupted after {state.step} steps; continue with --resume"
    text = f"{weights_path(request.out)}: {state.step} steps, {state.views} views"
    return text if outcome.scores is None else f"{text}\n{_scores_text(outcome)}"


def _scores_text(outcome: Outcome) -> str:
    """The scores by name, with their unit, beside those of the starting weights."""
    assert outcome.scores is not None
    sequences, views = outcome.held_out
    lines = [f"on {views} views of {sequences} held-out sequences:"]
    before = outcome.start_scores
    for name, (what, unit) in _SCORES.items():
        line = f"  {what} {getattr(outcome.scores, name):.1f} {unit}"
        lines.append(line if before is None
                     else f"{line} (starting weights {getattr(before, name):.1f})")  # fmt: skip
    if sequences < _FEW:
        lines.append(
            f"  fewer than {_FEW} sequences: another person or place may score differently"
        )
    return "\n".join(lines)


def weights_path(out: Path) -> Path:
    """Path of the final weights of a run."""
    return out / "detector.safetensors"


def split(folders: list[Path], share: float) -> tuple[list[Path], list[Path]]:
    """Split sequences for training and validation: every n-th one is held out."""
    if share == 0.0 or len(folders) < 2:
        return folders, []
    every = max(2, round(1.0 / share))
    return (
        [f for i, f in enumerate(folders) if i % every],
        [f for i, f in enumerate(folders) if i % every == 0],
    )


def join_processes() -> None:
    """Join the process group of torchrun, if there is one."""
    if int(os.environ.get("WORLD_SIZE", "1")) == 1:
        return
    import torch.distributed.nn  # before the group is: its default arguments would keep that

    cuda = torch.cuda.is_available()
    if cuda:
        torch.cuda.set_device(int(os.environ["LOCAL_RANK"]))
    torch.distributed.init_process_group("nccl" if cuda else "gloo")
    # Its threads release tensors, for which they need Python; they end with the last reference.
    atexit.register(torch.distributed.destroy_process_group)


def command_for_devices(words: Sequence[str], module: str = "egocap") -> list[str] | None:
    """Command that runs a program on all GPUs with torchrun; None with fewer than two GPUs."""
    import torch

    if "WORLD_SIZE" in os.environ or torch.cuda.device_count() < 2:
        return None
    count = str(torch.cuda.device_count())
    launcher = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", count]
    return [sys.executable, *launcher, "-m", module, *words]


def _prepare(request: RunConfig, training: TrainingConfig, network: NetworkConfig) -> None:
    """Make the run's folder, or check that an existing one belongs to this run."""
    what = {"network": network.to_dict(), "seed": training.seed, "batch": training.batch}
    path = request.out / RUN
    if (request.out / CHECKPOINT).exists() or (request.out / FINAL).exists():
        if not request.resume:
            raise InputError(
                f"{request.out} holds a run already", valid="another --out, or --resume"
            )
        before = read_json(path)
        if before != json.loads(json.dumps(what)):
            raise InputError(
                f"{request.out} holds a run with another network, seed or batch",
                valid="the same --config, --seed and --batch, or another --out",
            )
        return
    make_folder(request.out)
    if os.environ.get("RANK", "0") == "0":  # the others hold no lock of the folder
        write_json(path, what)


def _start(request: RunConfig, network: NetworkConfig) -> dict[str, torch.Tensor] | None:
    """Initial weights. Raises FileError if they are of another network."""
    if request.start is None:
        return None
    if request.start.suffix == ".safetensors" and request.start.name != FINAL:
        state = open_weights(request.start).network().state_dict()
    else:
        state = load_run_weights(request.start)
    from egocap.detect.network import build_network

    wanted = build_network(network).state_dict()
    if {k: v.shape for k, v in wanted.items()} != {
        k: getattr(v, "shape", None) for k, v in state.items()
    }:
        raise FileError(
            request.start, f"weights of another network than '{request.config}'",
            valid="weights trained with the same --config",
        )  # fmt: skip
    if spoilt := [name for name, tensor in state.items() if not tensor.isfinite().all()]:
        raise FileError(request.start, "holds values that are not finite", key=spoilt[0])
    return state


def _stores(request: RunConfig, network: NetworkConfig) -> tuple[ViewStore, ViewStore | None]:
    import torch

    store = request.store or request.out / "views"
    several = torch.distributed.is_available() and torch.distributed.is_initialized()
    if several and torch.distributed.get_rank() != 0:
        torch.distributed.barrier()  # the first process fills the store
    if request.shares:  # split each DATA separately, so that none is held out entirely
        parts = [split(find_sequences([data]), request.held_out) for data in request.data]
    else:
        parts = [split(find_sequences(request.data), request.held_out)]
    trained = [build_store(kept, network.view, store) for kept, _ in parts]
    held_out = list(chain.from_iterable(checked for _, checked in parts))
    stores = (
        mixed(trained, request.shares or (1.0,)),
        build_store(held_out, network.view, store) if held_out else None,
    )
    if several and torch.distributed.get_rank() == 0:
        torch.distributed.barrier()
    return stores


def _backgrounds(request: RunConfig, network: NetworkConfig) -> ViewStore | None:
    if not request.backgrounds:
        return None
    store = request.store or request.out / "views"
    return build_store(find_sequences(request.backgrounds), network.view, store)


def _account(
    request: RunConfig, training: TrainingConfig, kept: ViewStore, outcome: Outcome
) -> dict[str, Any]:
    """Training record for the weights file."""
    return {
        "data": [path.name for path in request.data],
        "shares": list(request.shares),
        "start": _origin(request.start),
        "sequences": len(kept.sequences), "views": len(kept), "views_left_out": kept.skipped,
        "steps": outcome.state.step, "views_seen": outcome.state.views,
        "seconds": round(outcome.state.seconds, 1),
        "training": asdict(training),
        "scores": None if outcome.scores is None else outcome.scores.to_dict(),
    }  # fmt: skip


def _without_folder(word: str) -> str:
    """A word of the command, with absolute paths reduced to the file name."""
    return Path(word).name if word.startswith("/") else word


def _origin(start: Path | None) -> dict[str, Any] | None:
    """Name of the initial weights, with their training record if they have one."""
    if start is None:
        return None
    if start.suffix != ".safetensors" or start.name == FINAL:
        return {"name": start.name}
    weights = open_weights(start)
    training = {k: v for k, v in weights.training.items() if k != "scores"}
    return {"name": weights.name, "sha256": weights.sha256, "training": training}
