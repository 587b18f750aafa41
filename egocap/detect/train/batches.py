"""Batches of augmented training views, made ahead of the network by a thread or by processes.

A batch depends only on seed, process of the training and step.
"""

from __future__ import annotations

import signal
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import count
from typing import TypeAlias

import numpy as np
import torch
from jaxtyping import Float, Int64, UInt8
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from egocap.detect.engine import available_cores
from egocap.detect.train.augmentation import augment
from egocap.detect.train.config import AugmentationConfig
from egocap.detect.train.examples import Example, Views, ViewStore

Batch: TypeAlias = tuple[UInt8[Tensor, "B H W 3"], Float[Tensor, "B 18 2"], Int64[Tensor, "B 18"]]
"""Images, points and states, as in `Example`."""


@dataclass(frozen=True, eq=False)
class Batches(Dataset[Batch]):
    """The batches of one process of a training, by step."""

    training: ViewStore
    backgrounds: ViewStore
    augmentation: AugmentationConfig
    size: int  # views
    seed: int
    process: int = 0

    def __getitem__(self, step: int) -> Batch:
        rng = np.random.default_rng([self.seed, self.process, step])
        made = []
        for _ in range(self.size):
            view, other = self.training.draw(rng), self.backgrounds.draw(rng)
            made.append(augment(example(*view), self.augmentation, rng, example(*other)))
        return (
            torch.from_numpy(np.stack([e.image for e in made])),
            torch.from_numpy(np.stack([e.points for e in made]).astype(np.float32)),
            torch.from_numpy(np.stack([e.state for e in made]).astype(np.int64)),
        )

    def from_step(self, step: int, workers: int) -> Iterator[Batch]:
        """Batches from a step on, without end.

        Args:
            step: the first.
            workers: processes that make them, forked because the memory maps are shared; 0: a
                thread, which leaves the cores to a network on the processor.
        """
        if workers == 0:
            return self._of_thread(step)
        return iter(DataLoader(
            self, batch_size=None, sampler=count(step), num_workers=workers, prefetch_factor=4,
            pin_memory=torch.cuda.is_available(), multiprocessing_context="fork",
            worker_init_fn=_ignore_interrupt,
        ))  # fmt: skip

    def _of_thread(self, step: int) -> Iterator[Batch]:
        with ThreadPoolExecutor(1) as pool:
            ahead = [pool.submit(self.__getitem__, step), pool.submit(self.__getitem__, step + 1)]
            for following in count(step + 2):
                yield ahead.pop(0).result()
                ahead.append(pool.submit(self.__getitem__, following))


def workers_for(device: torch.device, trainings: int) -> int:
    """Processes that make the batches of one of several trainings on this machine.

    For a GPU, as many as its share of the cores less the one that trains.
    """
    return max(available_cores() // trainings - 1, 1) if device.type == "cuda" else 0


def example(views: Views, row: int) -> Example:
    """One view of a sequence, read from disk."""
    parts = None if views.parts is None else np.asarray(views.parts[row])
    return Example(
        np.asarray(views.images[row]), views.points[row].astype(float), views.state[row], parts
    )


def _ignore_interrupt(_: int) -> None:
    """Leave Ctrl-C to the process that trains, which ends the run after a step."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
