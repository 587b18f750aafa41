"""Training of the detector: batches, schedule, averaging and checkpoints, on one or more devices.

The folder of a run holds run.json, log.csv and curves.png (`train.curves`), checkpoint.pt, and
final.safetensors, the averaged weights with fitted sigma. A batch depends only on seed, process and
step, so that a resumed run equals an uninterrupted one.
"""

from __future__ import annotations

import logging
import math
import os
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn
from torch.optim.swa_utils import get_ema_multi_avg_fn

from egocap.detect.network import DetectorNetwork, NetworkConfig, build_network
from egocap.detect.train.batches import Batch, Batches, workers_for
from egocap.detect.train.checkpoint import (
    RunState,
    restore_checkpoint,
    save_checkpoint,
    save_run_weights,
)
from egocap.detect.train.config import TrainingConfig
from egocap.detect.train.curves import RunLog
from egocap.detect.train.examples import ViewStore
from egocap.detect.train.interruption import Interruption
from egocap.detect.train.loss import Losses, losses
from egocap.detect.train.mixed_precision import mixed_precision
from egocap.detect.train.validation import Scores, predict, score, sigma_bias

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Outcome:
    """Result of a run."""

    finished: bool  # False: interrupted
    state: RunState
    scores: Scores | None  # of the final weights on the held-out views
    weights: Path | None  # final.safetensors
    start_scores: Scores | None = None  # of the starting weights on the same views
    held_out: tuple[int, int] = (0, 0)  # sequences and views scored


class Trainer:
    """One run in one process; several processes have one device each."""

    def __init__(
        self,
        network: NetworkConfig,
        config: TrainingConfig,
        training: ViewStore,
        validation: ViewStore | None,
        folder: Path,
        start: dict[str, Any] | None = None,
        backgrounds: ViewStore | None = None,
    ) -> None:
        """`start`: initial state dictionary; `backgrounds`: the training views when None."""
        self.config, self.folder = config, folder
        self.training, self.validation = training, validation
        self.backgrounds = training if backgrounds is None else backgrounds
        self.rank, self.world = (
            int(os.environ.get("RANK", "0")),
            int(os.environ.get("WORLD_SIZE", "1")),
        )
        self.device = _device(int(os.environ.get("LOCAL_RANK", "0")))
        torch.manual_seed(config.seed)
        self.network = build_network(network)
        self._started = start is not None
        self._start_scores: Scores | None = None
        if start is not None:
            self.network.load_state_dict(start)
        if not (config.loss.visibility or config.loss.spread):
            self.network.info.requires_grad_(False)  # else weight decay alone would change it
        self.network.to(self.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.average = build_network(network).to(self.device)
        self.average.load_state_dict(self.network.state_dict())
        self.average.eval()
        self.optimiser = torch.optim.AdamW(
            _groups(self.network, config.weight_decay), lr=config.learning_rate, fused=True
        )
        self.state = RunState()
        self._run: nn.Module = self.network
        if self.world > 1:
            self._run = nn.parallel.DistributedDataParallel(self.network)
        if config.compile:
            self._run = torch.compile(self._run)  # type: ignore[assignment]

    def resume(self) -> bool:
        """Load the folder's checkpoint; False if there is none. Raises FileError."""
        state = restore_checkpoint(
            self.folder, self.network, self.average, self.optimiser, self.device
        )
        if state is not None:
            self.state = state
        return state is not None

    def run(self) -> Outcome:
        """Train until finished or interrupted, with validation, logging and checkpoints."""
        record = RunLog(self.folder, self.state.step) if self.rank == 0 else None
        if self.progress() >= 1.0:  # resumed when it was finished
            return self._finish(record)
        since_check = since_validation = self.state.seconds
        if self._started and self.state.step == 0:
            self._start_scores = self._validate(record)
        self.network.train()
        with Interruption() as stop:
            for batch in self._batches():
                begun = time.monotonic()
                terms = self._step(batch)
                self.state.step += 1
                self.state.views += len(batch[0]) * self.world
                spent = time.monotonic() - begun + self._waited
                self.state.seconds = self._agreed_seconds(self.state.seconds + spent)
                done = self.progress() >= 1.0
                if record is not None:
                    record.step(self.state, terms, self._rate(), self.progress(), self._left())
                if self._due(since_validation, self.config.validate_minutes) and not done:
                    since_validation = self.state.seconds
                    self._validate(record)
                if self._due(since_check, self.config.checkpoint_minutes) and not done:
                    since_check = self.state.seconds
                    self._checkpoint()
                if done or self._agreed(stop.requested):
                    break
        self._checkpoint()
        if self.progress() < 1.0:
            return Outcome(False, self.state, None, None)
        return self._finish(record)

    def progress(self) -> float:
        """Fraction of the run that is done, by steps or time."""
        if self.config.steps:
            return self.state.step / self.config.steps
        return self.state.seconds / (60.0 * self.config.minutes)

    def _step(self, batch: Batch) -> Losses:
        images, points, state = (t.to(self.device, non_blocking=True) for t in batch)
        for group in self.optimiser.param_groups:
            group["lr"] = self._rate()
        with mixed_precision(self.device):
            heat, info = self._run(images)
        stride = self.network.config.stride
        terms = losses(heat.float(), info.float(), points, state, stride, self.config.loss)
        terms.total(self.config.loss).backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), 5.0)
        self.optimiser.step()
        self.optimiser.zero_grad(set_to_none=True)
        self._move_average()
        return terms

    def _rate(self) -> float:
        """Learning rate: linear rise, then cosine decay to 1 % of the peak."""
        done, rise = min(self.progress(), 1.0), self.config.warm_up
        if done < rise:
            return self.config.learning_rate * (0.05 + 0.95 * done / rise)
        fall = (done - rise) / max(1.0 - rise, 1e-9)
        return self.config.learning_rate * (0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * fall)))

    @torch.no_grad()
    def _move_average(self) -> None:
        decay = min(self.config.average, (1.0 + self.state.step) / (10.0 + self.state.step))
        mine, theirs = self.average.state_dict(), self.network.state_dict()
        floats = [k for k, v in mine.items() if v.is_floating_point()]
        move = get_ema_multi_avg_fn(decay)
        move([mine[k] for k in floats], [theirs[k] for k in floats], self.state.step)

    def _batches(self) -> Iterator[Batch]:
        """Batches from the current step on, with the time waited for each."""
        batches = Batches(
            self.training, self.backgrounds, self.config.augmentation, self.config.batch,
            self.config.seed, self.rank,
        )  # fmt: skip
        local = int(os.environ.get("LOCAL_WORLD_SIZE", "1"))
        ahead = batches.from_step(self.state.step, workers_for(self.device, local))
        while True:
            begun = time.monotonic()
            batch = next(ahead)
            self._waited = time.monotonic() - begun
            yield batch

    def _validate(self, record: RunLog | None) -> Scores | None:
        if self.validation is None or record is None:
            return None
        scores = score(predict(self.average, self.validation, self._held_out()))
        record.validation(self.state, scores)
        return scores

    def _held_out(self) -> np.ndarray:
        """Fixed views, evenly spaced over the held-out sequences."""
        assert self.validation is not None
        count = min(self.config.validation_views, len(self.validation))
        return np.unique(np.linspace(0, len(self.validation) - 1, count).astype(int))

    def _checkpoint(self) -> None:
        if self.rank == 0:
            save_checkpoint(
                self.folder, self.network, self.average, self.optimiser, asdict(self.state)
            )

    def _finish(self, record: RunLog | None) -> Outcome:
        if self.rank != 0 or record is None:
            return Outcome(True, self.state, None, None)
        scores, held_out = None, (0, 0)
        if self.validation is not None:
            indices = self._held_out()
            held_out = len(self.validation.sequences), len(indices)
            bias = sigma_bias(predict(self.average, self.validation, indices))
            self.average.info.log_sigma_bias.add_(torch.from_numpy(bias).to(self.device))
            scores = score(predict(self.average, self.validation, indices))
            record.validation(self.state, scores)
        path = save_run_weights(self.folder, self.average, scores)
        record.close()
        return Outcome(True, self.state, scores, path, self._start_scores, held_out)

    def _left(self) -> float:
        """Estimated remaining training time, seconds."""
        done = self.progress()
        return self.state.seconds * max(1.0 - done, 0.0) / max(done, 1e-9)

    def _due(self, since: float, minutes: float) -> bool:
        return self.state.seconds - since >= 60.0 * minutes

    def _agreed_seconds(self, seconds: float) -> float:
        """Time of the first process, so that all processes stop at the same step."""
        if self.world == 1:
            return seconds
        clock = torch.tensor(seconds, device=self.device)
        torch.distributed.broadcast(clock, 0)
        return float(clock)

    def _agreed(self, stop: bool) -> bool:
        if self.world == 1:
            return stop
        flag = torch.tensor(float(stop), device=self.device)
        torch.distributed.all_reduce(flag, torch.distributed.ReduceOp.MAX)
        return bool(flag > 0)


def _device(local_rank: int) -> torch.device:
    if torch.cuda.is_available():
        torch.backends.cudnn.benchmark = True  # all batches are of one size
        return torch.device("cuda", local_rank)
    return torch.device("cpu")


def _groups(network: DetectorNetwork, decay: float) -> list[dict[str, Any]]:
    """Parameter groups: weight decay for matrices, none for scales and biases."""
    weights = [p for p in network.parameters() if p.ndim > 1]
    others = [p for p in network.parameters() if p.ndim <= 1]
    return [{"params": weights, "weight_decay": decay}, {"params": others, "weight_decay": 0.0}]
