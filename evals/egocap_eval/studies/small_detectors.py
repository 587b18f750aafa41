"""Train small detectors for a few minutes, to compare their training data.

Every case is footage and augmentation; every seed trains one detector for each, all of them for
the same number of steps and scored on the same held-out views.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from tyro.conf import Positional, arg

from egocap.detect.train.config import AugmentationConfig, TrainingConfig
from egocap.errors import InputError
from egocap.evaluation.table import Table, number
from egocap_eval.harness.cases import Scores, run_cases

if TYPE_CHECKING:
    from egocap.detect.network import NetworkConfig
    from egocap.detect.train.examples import ViewStore

COLUMNS = ("pck", "auc", "pck_in_view", "pck_wrist", "pck_ankle", "pck_foot")
Cells = Mapping[str, Mapping[str, float | None]]
Case = tuple["ViewStore", AugmentationConfig]


@dataclass(frozen=True)
class Trainings:
    """Settings that all compared trainings share."""

    footage: Positional[Annotated[tuple[Path, ...], arg(metavar="DIR")]]
    """Sequences before a green screen with part labels (scene train-chroma)."""
    held_out: Annotated[tuple[Path, ...], arg(metavar="DIR")]
    """Sequences of other people in real places, to score on."""
    backgrounds: Annotated[tuple[Path, ...], arg(metavar="DIR")]
    """Sequences whose images replace the green screen."""
    steps: int = 800
    """Training steps of each detector."""
    batch: int = 32
    """Views per step."""
    seeds: int = 3
    """Detectors trained for each row; error bars are over them."""
    network: str = "small"
    """Network configuration to train."""
    views: int = 1000
    """Number of held-out views to score."""
    store: Annotated[Path | None, arg(metavar="DIR")] = None
    """Folder for canonical views and runs; temporary by default."""


@dataclass(frozen=True, eq=False)
class TrainingSetup:
    """The views that detectors of a comparison are trained and scored on."""

    trainings: Trainings
    network: NetworkConfig
    footage: ViewStore
    held_out: ViewStore
    backgrounds: ViewStore
    folder: Path  # for runs, which are removed again

    def compare(self, cases: Mapping[str, Case]) -> dict[str, list[Scores]]:
        """Scores in `COLUMNS` of a detector for each case and seed."""
        seeds = self.trainings.seeds
        runs = run_cases("training", cases, {"held out": self}, _trained_scores, seeds=seeds)
        return {name: list(of_subjects[0]) for name, of_subjects in runs.items()}


@contextmanager
def prepare_training(trainings: Trainings) -> Iterator[TrainingSetup]:
    """Prepare training, held-out and background views, in the store or a temporary folder.

    Raises InputError for an unknown network or a count of zero, FileError for folders without
    sequences.
    """
    from egocap.data.dataset import find_sequences
    from egocap.detect.network import config_named
    from egocap.detect.train.examples import build_store

    t = trainings
    if t.seeds < 1 or t.steps < 1 or t.views < 1:
        raise InputError(
            f"{t.seeds} seeds, {t.steps} steps, {t.views} views", valid="1 or more of each"
        )
    config = config_named(t.network)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) if t.store is None else t.store
        train, held_out, backgrounds = (
            build_store(find_sequences(paths), config.view, folder / "views")
            for paths in (t.footage, t.held_out, t.backgrounds)
        )
        yield TrainingSetup(t, config, train, held_out, backgrounds, folder)


def _trained_scores(case: Case, setup: TrainingSetup, seed: int) -> Scores:
    from egocap.detect.train.trainer import Trainer
    from egocap.detect.train.validation import predict, score

    footage, augmentation = case
    training = TrainingConfig(
        steps=setup.trainings.steps, batch=setup.trainings.batch, seed=seed, average=0.99,
        validate_minutes=1e6, checkpoint_minutes=1e6, augmentation=augmentation,
    )  # fmt: skip
    with tempfile.TemporaryDirectory(dir=setup.folder) as folder:
        trainer = Trainer(
            setup.network, training, footage, None, Path(folder), backgrounds=setup.backgrounds
        )
        trainer.run()
    count = min(setup.trainings.views, len(setup.held_out))
    indices = np.unique(np.linspace(0, len(setup.held_out) - 1, count).astype(int))
    found = score(predict(trainer.average, setup.held_out, indices))
    return {column: getattr(found, column) for column in COLUMNS}


def summary(seeds: Sequence[Scores]) -> dict[str, Any]:
    """Mean and standard error over the seeds of each column."""
    return {c: _mean_and_error([scores[c] for scores in seeds]) for c in COLUMNS}


def difference(first: Sequence[Scores], second: Sequence[Scores]) -> dict[str, float | None]:
    """PCK of the first less that of the second, paired by seed, and its standard error."""
    return _mean_and_error([a["pck"] - b["pck"] for a, b in zip(first, second, strict=True)])


def _mean_and_error(values: Sequence[float]) -> dict[str, float | None]:
    several = len(values) > 1
    error = float(np.std(values, ddof=1) / np.sqrt(len(values))) if several else None
    return {"mean": float(np.mean(values)), "error": error}


def table(rows: Mapping[str, Cells]) -> Table:
    """A row for each training, columns of scores with their standard errors."""
    cells = tuple((name, *(with_error(row[c]) for c in COLUMNS)) for name, row in rows.items())
    head = ("PCK@20", "AUC", "in view", "wrists", "ankles", "feet")
    return Table("visible labels, % (standard error)", ("training", *head), cells)


def with_error(cell: Mapping[str, float | None]) -> str:
    """A mean with its standard error in brackets."""
    error = cell["error"]
    return number(cell["mean"]) + ("" if error is None else f" ({error:.1f})")
