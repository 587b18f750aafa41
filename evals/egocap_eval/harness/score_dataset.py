"""Scores of poses on a published data set, read in place, and its submission files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import arg

from egocap.cameras.rig_files import load_rig
from egocap.data.detections import load_detections
from egocap.data.track import load_track
from egocap.datasets.catalogue import DATASETS, find_recording, open_dataset
from egocap.datasets.recording import Recording
from egocap.datasets.scoring import evaluate_recording, joints_in_head
from egocap.datasets.submissions import Prediction, write_submission
from egocap.errors import FileError, InputError
from egocap.evaluation.frame_matching import Missing
from egocap.evaluation.predictions import SUFFIXES, load_predictions
from egocap.evaluation.report import Report
from egocap.evaluation.table import Table, number
from egocap_eval.harness.study import Outcome


@dataclass(frozen=True)
class DatasetOptions:
    """A published data set in place of a sequence."""

    dataset: Annotated[str | None, arg(metavar="NAME:PATH")] = None
    """Data set and its folder, e.g. unrealego2:/data/UnrealEgoData2. Results in a folder are
    those of its sequences, by their names."""
    sequence: Annotated[str | None, arg(metavar="NAME")] = None
    """The one sequence of the data set that the result belongs to."""
    rig: Annotated[Path | None, arg(metavar="FILE")] = None
    """Rig file that replaces the data set's cameras."""
    submission: Annotated[Path | None, arg(metavar="FILE")] = None
    """Also write the poses in the data set's submission format."""


NO_DATASET = DatasetOptions()


def score_dataset(
    options: DatasetOptions,
    track: Path | None,
    predictions: Path | None,
    detections: str | None,
    protocol: str | None,
    missing: Missing,
) -> Outcome:
    """Score a result file, or a folder of them, against the labels of a data set.

    Where the data set withholds its labels only the submission is written.
    """
    path = track or predictions
    assert path is not None and options.dataset is not None
    found = None if detections is None else load_detections(Path(detections))
    reports, written = {}, []
    for recording, file in _pairs(options, path):
        result = load_track(file) if track is not None else load_predictions(file)
        try:
            if recording.labels is not None or options.submission is None:
                reports[recording.name] = evaluate_recording(
                    result, recording, protocol=protocol, detections=found, missing=missing
                )
            if options.submission is not None:
                written.append(Prediction(recording, *joints_in_head(result, recording)))
        except InputError as error:
            raise FileError(file, str(error)) from None
    if options.submission is not None:
        write_submission(written, options.submission)
    return _outcome(options, path, reports, written)


def _pairs(options: DatasetOptions, path: Path) -> Iterator[tuple[Recording, Path]]:
    """Recordings and the files of their results."""
    assert options.dataset is not None
    rig = None if options.rig is None else load_rig(options.rig)
    if not path.is_dir():
        yield find_recording(options.dataset, options.sequence, rig), path
        return
    for recording in open_dataset(options.dataset, rig):
        if options.sequence in (None, recording.name):
            yield recording, _file_of(path, recording.name)


def _file_of(folder: Path, name: str) -> Path:
    for suffix in (".track.npz", *SUFFIXES):
        if (folder / f"{name}{suffix}").is_file():
            return folder / f"{name}{suffix}"
    raise FileError(folder / f"{name}.npz", "no result of this sequence",
                    valid=[f"{name}{suffix}" for suffix in (".track.npz", *SUFFIXES)])  # fmt: skip


def _outcome(
    options: DatasetOptions, path: Path, reports: dict[str, Report], written: list[Prediction]
) -> Outcome:
    provenance = {"dataset": options.dataset, "result": str(path)}
    if options.submission is not None:
        provenance["submission"] = str(options.submission)
    if not reports:
        result = {"submission": str(options.submission), "sequences": len(written)}
        heading = f"{options.submission}: {len(written)} sequences, not scored"
        return Outcome(result, heading=heading)
    if len(reports) == 1:
        (report,) = (replace(r, provenance=provenance) for r in reports.values())
        return Outcome(report.to_dict(), report.tables(), heading=report.heading())
    return _summary(options, reports, provenance)


def _summary(
    options: DatasetOptions, reports: dict[str, Report], provenance: dict[str, str | None]
) -> Outcome:
    """Means over the frames of all sequences, and each sequence's own; None where one has none."""
    counts = [report.frames for report in reports.values()]
    frames, mean = sum(counts), {}
    for key in ("mpjpe_mm", "pa_mpjpe_mm"):
        own = [getattr(report, key) for report in reports.values()]
        mean[key] = None if None in own else float(np.average(own, weights=counts))
    rows = [(name, str(r.frames), number(r.mpjpe_mm), number(r.pa_mpjpe_mm))
            for name, r in reports.items()]  # fmt: skip
    rows.append(("all", str(frames), number(mean["mpjpe_mm"]), number(mean["pa_mpjpe_mm"])))
    header = ("sequence", "frames", "MPJPE mm", "PA-MPJPE mm")
    title = DATASETS[str(options.dataset).partition(":")[0]].title
    protocol = next(iter(reports.values())).protocol
    result = {"protocol": protocol, "frames": frames, **mean, "provenance": provenance,
              "sequences": {n: r.to_dict() for n, r in reports.items()}}  # fmt: skip
    return Outcome(result, [Table(f"{title}: {protocol}", header, tuple(rows))])
