"""Small detectors trained for a few minutes, to compare what they were trained on."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from egocap.commandline import progress
from egocap.detect.train.config import AugmentationConfig, TrainingConfig
from egocap.errors import InputError
from egocap.evaluation.table import Table, number

if TYPE_CHECKING:
    from egocap.detect.network import NetworkConfig
    from egocap.detect.train.examples import ViewStore
    from egocap.detect.train.validation import Scores

COLUMNS = ("pck", "auc", "pck_in_view", "pck_wrist", "pck_ankle", "pck_foot")
Cells = Mapping[str, Mapping[str, float | None]]


def configured(
    steps: int, batch: int, seed: int, augmentation: AugmentationConfig
) -> TrainingConfig:
    """Settings of a short run by steps, without validation or checkpoints on the way."""
    return TrainingConfig(
        steps=steps, batch=batch, seed=seed, average=0.99, validate_minutes=1e6,
        checkpoint_minutes=1e6, augmentation=augmentation,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Ground:
    """What detectors of a comparison have in common."""

    network: NetworkConfig
    footage: ViewStore
    held_out: ViewStore
    backgrounds: ViewStore
    place: Path  # for runs, which are removed again

    def compare(
        self, cases: Mapping[str, tuple[ViewStore, AugmentationConfig]],
        steps: int, batch: int, seeds: int, views: int,
    ) -> dict[str, list[Scores]]:  # fmt: skip
        """Scores of a detector for each case and seed, cases being footage and augmentation."""
        found: dict[str, list[Scores]] = {name: [] for name in cases}
        with progress("training", seeds * len(cases), unit="detectors") as advance:
            for seed in range(seeds):
                for name, (footage, augmentation) in cases.items():
                    training = configured(steps, batch, seed, augmentation)
                    found[name].append(trained_scores(
                        self.network, training, footage, self.held_out, views, self.place,
                        self.backgrounds,
                    ))  # fmt: skip
                    advance()
        return found


@contextmanager
def ground(
    network: str, footage: Sequence[Path], held_out: Sequence[Path], backgrounds: Sequence[Path],
    store: Path | None,
) -> Iterator[Ground]:  # fmt: skip
    """Views of all that is trained and scored on, kept in `store` or in a temporary folder.

    Raises InputError for an unknown network, FileError for folders without sequences.
    """
    from egocap.data.dataset import find_sequences
    from egocap.detect.network import config_named
    from egocap.detect.train.examples import build_store

    config = config_named(network)
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) if store is None else store
        train, judge, behind = (
            build_store(find_sequences(paths), config.view, place / "views")
            for paths in (footage, held_out, backgrounds)
        )
        yield Ground(config, train, judge, behind, place)


def require_some(seeds: int, steps: int, views: int) -> None:
    """Raise InputError where one of them is none."""
    if seeds < 1 or steps < 1 or views < 1:
        raise InputError(f"{seeds} seeds, {steps} steps, {views} views", valid="1 or more of each")


def trained_scores(
    network: NetworkConfig,
    training: TrainingConfig,
    footage: ViewStore,
    held_out: ViewStore,
    views: int,
    place: Path,
    backgrounds: ViewStore | None = None,
) -> Scores:
    """Scores, on so many views of the held-out store, of a detector trained on another.

    `place` is a folder for the run, which is removed again.
    """
    from egocap.detect.train.trainer import Trainer
    from egocap.detect.train.validation import predict, score

    with tempfile.TemporaryDirectory(dir=place) as folder:
        trainer = Trainer(network, training, footage, None, Path(folder), backgrounds=backgrounds)
        trainer.run()
    count = min(views, len(held_out))
    indices = np.unique(np.linspace(0, len(held_out) - 1, count).astype(int))
    return score(predict(trainer.average, held_out, indices))


def summary(scores: Sequence[Scores]) -> dict[str, Any]:
    """Mean and standard error over the seeds of each column."""
    columns = {c: np.array([getattr(s, c) for s in scores]) for c in COLUMNS}
    several = len(scores) > 1
    return {
        c: {
            "mean": float(v.mean()),
            "error": float(v.std(ddof=1) / np.sqrt(len(v))) if several else None,
        }
        for c, v in columns.items()
    }


def difference(first: Sequence[Scores], second: Sequence[Scores]) -> dict[str, float | None]:
    """Points of PCK that the second lacks beside the first, seed by seed, and their error."""
    lost = np.array([a.pck - b.pck for a, b in zip(first, second, strict=True)])
    error = float(lost.std(ddof=1) / np.sqrt(len(lost))) if len(lost) > 1 else None
    return {"mean": float(lost.mean()), "error": error}


def table(rows: Mapping[str, Cells]) -> Table:
    """A row for each training, columns of scores with their standard errors."""
    cells = tuple((name, *(with_error(row[c]) for c in COLUMNS)) for name, row in rows.items())
    head = ("PCK@20", "AUC", "in view", "wrists", "ankles", "feet")
    return Table("visible labels, % (standard error)", ("training", *head), cells)


def with_error(cell: Mapping[str, float | None]) -> str:
    """A mean with its standard error in brackets."""
    error = cell["error"]
    return number(cell["mean"]) + ("" if error is None else f" ({error:.1f})")
