"""Record of a training run: log.csv, validation.csv, curves.png, and log messages."""

from __future__ import annotations

import csv
import logging
import time
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from egocap.errors import FileError
from egocap.files import replacing, write_atomically
from egocap.schema import read_text

if TYPE_CHECKING:
    from egocap.detect.train.checkpoint import RunState
    from egocap.detect.train.loss import Losses
    from egocap.detect.train.validation import Scores

log = logging.getLogger(__name__)

TERMS = ("heat", "place", "visibility", "spread")
_SCORES = ("pck", "auc", "pck_wrist", "pck_ankle", "pck_foot")  # drawn
_EVERY = 20  # steps between two rows of log.csv, which are means over them
_LOG_S = 30.0  # between log messages


class RunLog:
    """Appends to a run folder's record, behind the rows up to the step it is resumed from."""

    def __init__(self, folder: Path, step: int) -> None:
        self._folder = folder
        self._sums, self._count = np.zeros(len(TERMS)), 0
        self._logged, self._views_logged = time.monotonic(), -1
        for name in ("log.csv", "validation.csv"):
            if step == 0:
                (folder / name).unlink(missing_ok=True)
            _cut(folder / name, step)
        if not (folder / "log.csv").exists():
            _row(folder / "log.csv", ("step", "seconds", "views", "rate", *TERMS))

    def step(
        self, state: RunState, terms: Losses, rate: float, progress: float, left: float
    ) -> None:
        """Add a step's losses; write and log their means at intervals."""
        self._sums += [float(getattr(terms, name).detach()) for name in TERMS]
        self._count += 1
        now = time.monotonic()
        if now - self._logged >= _LOG_S or self._views_logged < 0:
            speed = (state.views - self._views_logged) / max(now - self._logged, 1e-9)
            speed = speed if self._views_logged >= 0 else 0.0
            self._logged, self._views_logged = now, state.views
            heat = self._sums[0] / self._count
            log.info(
                "step %d, %.1f %%, %.0f views/s, %.0f min left, heat %.3f",
                state.step, 100 * progress, speed, left / 60, heat,
            )  # fmt: skip
        if state.step % _EVERY == 0:
            means = [f"{v:.5f}" for v in self._sums / self._count]
            row = (state.step, f"{state.seconds:.1f}", state.views, f"{rate:.3e}", *means)
            _row(self._folder / "log.csv", row)
            self._sums[:], self._count = 0.0, 0

    def validation(self, state: RunState, scores: Scores) -> None:
        """Add a validation and draw the curves."""
        values = scores.to_dict()
        path = self._folder / "validation.csv"
        _cut(path, state.step - 1)  # a finished run that is resumed is scored again
        if not path.exists():
            _row(path, ("step", "seconds", "views", *values))
        rounded = [f"{v:.4f}" for v in values.values()]
        _row(path, (state.step, f"{state.seconds:.1f}", state.views, *rounded))
        log.info(
            "step %d: PCK %.1f, AUC %.1f, error %.1f px, wrists %.1f, ankles %.1f",
            state.step, scores.pck, scores.auc, scores.error_px, scores.pck_wrist,
            scores.pck_ankle,
        )  # fmt: skip
        draw_curves(self._folder)

    def close(self) -> None:
        """Draw the final curves."""
        draw_curves(self._folder)


def draw_curves(folder: Path) -> Path | None:
    """curves.png from log.csv and validation.csv; None without either."""
    losses, scores = (
        _read(folder / "log.csv", ("views", *TERMS)),
        _read(folder / "validation.csv", ("views", *_SCORES)),
    )
    if not losses and not scores:
        return None
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, (left, right) = pyplot.subplots(1, 2, figsize=(11, 4), layout="constrained")
    for name in TERMS if losses else ():
        few = len(losses["views"]) < 50  # a line of one point is not seen
        left.plot(losses["views"], losses[name], label=name, linewidth=0.8, marker="." * few)
    left.set(xlabel="views", ylabel="loss", title="training")
    if losses:
        left.legend()
    for name in _SCORES if scores else ():
        right.plot(scores["views"], scores[name], label=name, marker=".")
    right.set(xlabel="views", ylabel="%", title="held out", ylim=(0, 100))
    if scores:
        right.legend()
    path = folder / "curves.png"
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=90, format="png")
    pyplot.close(figure)
    return path


def _row(path: Path, values: Any) -> None:
    with path.open("a", newline="") as file:
        csv.writer(file).writerow(values)


def _cut(path: Path, step: int) -> None:
    """Drop a table's rows after a step, and one that was cut short. Raises FileError."""
    if not path.exists():
        return
    head, *rows = read_text(path).splitlines() or [""]
    kept = [row for row in rows if row.count(",") == head.count(",") and _step(row) <= step]
    if len(kept) < len(rows):
        write_atomically(path, "".join(f"{row}\r\n" for row in (head, *kept)))


def _step(row: str) -> float:
    """The step of a table's row; infinite for one that is damaged."""
    number = row.partition(",")[0]
    return int(number) if number.isdecimal() else np.inf


def _read(path: Path, needed: Collection[str]) -> dict[str, np.ndarray]:
    """The columns of a table; none where it is missing or damaged."""
    if not path.exists():
        return {}
    try:
        head, *rows = csv.reader(read_text(path).splitlines())
        columns = [*np.array([row for row in rows if len(row) == len(head)], float).T]
    except (FileError, ValueError, csv.Error):
        head, columns = [], []
    if not set(needed) <= set(head) or np.isinf(columns).any():
        log.warning("%s is damaged and not drawn", path)
        return {}
    return dict(zip(head, columns, strict=True)) if columns else {}
