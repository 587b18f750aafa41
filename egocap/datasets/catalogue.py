"""The data sets by name: which module reads each, and the protocol of its published numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from itertools import islice
from pathlib import Path

import numpy as np

from egocap.cameras.rig import Rig
from egocap.datasets.recording import Recording
from egocap.errors import FileError, InputError


@dataclass(frozen=True)
class DatasetEntry:
    """A published data set."""

    module: str  # of `egocap.datasets`
    protocol: str  # a name of `egocap.evaluation.PROTOCOLS`
    title: str


DATASETS: Mapping[str, DatasetEntry] = {
    "egocap": DatasetEntry("egocap_zips", "egocap-17", "EgoCap, SIGGRAPH Asia 2016"),
    "unrealego": DatasetEntry("unrealego", "unrealego-16-mid-hip", "UnrealEgo, ECCV 2022"),
    "unrealego2": DatasetEntry("unrealego", "unrealego-16", "UnrealEgo2, CVPR 2024"),
    "unrealego-rw": DatasetEntry("unrealego", "unrealego-16", "UnrealEgo-RW, CVPR 2024"),
    "ego4view-syn": DatasetEntry("unrealego", "unrealego-16", "Ego4View-Syn, ICCV 2025"),
    "ego4view-rw": DatasetEntry("unrealego", "unrealego-16", "Ego4View-RW, ICCV 2025"),
    "xr-egopose": DatasetEntry("xr_egopose", "unrealego-16", "xR-EgoPose, ICCV 2019"),
    "mo2cap2": DatasetEntry("mo2cap2", "mo2cap2-15-ba-rigid", "Mo2Cap2, IEEE VR 2019"),
    "sceneego": DatasetEntry("sceneego", "mo2cap2-15", "SceneEgo, CVPR 2023"),
    "egopw": DatasetEntry("sceneego", "mo2cap2-15-pa", "EgoPW, CVPR 2022 (pseudo labels)"),
    "egobody3m": DatasetEntry("egobody3m", "unrealego-16", "EgoBody3M, ECCV 2024"),
    "egowholemocap": DatasetEntry("egowholemocap", "mo2cap2-15", "EgoWholeMocap, CVPR 2024"),
}


def open_dataset(source: str, rig: Rig | None = None) -> Iterator[Recording]:
    """Read the sequences of a published data set, in place and one after another.

    Args:
        source: "NAME:PATH", a name of `DATASETS` and the data set's folder or a sequence in it.
        rig: cameras that replace those of the data set; the frame rate remains the data set's.

    Raises:
        InputError: no such name.
        FileError: a part is missing, damaged, or of another version of the data set.
    """
    name, path = parse_source(source)
    reader = import_module(f"egocap.datasets.{DATASETS[name].module}")
    return map(_at_own_rate, reader.recordings(name, path, rig))


def _at_own_rate(recording: Recording) -> Recording:
    """The recording with the frame rate of its times."""
    if len(recording) < 2:
        return recording
    rate = 1.0 / float(np.median(np.diff(recording.times)))
    return replace(recording, rig=replace(recording.rig, frame_rate=round(rate, 6)))


def find_recording(source: str, sequence: str | None = None, rig: Rig | None = None) -> Recording:
    """The one sequence at a "NAME:PATH", or that of the name `sequence`.

    Raises:
        InputError: there are several, or none of that name.
        FileError: as `open_dataset`.
    """
    found = open_dataset(source, rig)
    if sequence is None:
        first = list(islice(found, 5))
        if not first:
            raise FileError(parse_source(source)[1], "holds no sequence of this data set")
        if len(first) > 1:
            names = [recording.name for recording in first]
            raise InputError(f"{source} holds several sequences", valid=f"--sequence {names[0]}, "
                             f"{', '.join(names[1:])}, ...")  # fmt: skip
        return first[0]
    names = []
    for recording in found:
        if recording.name == sequence:
            return recording
        names.append(recording.name)
    raise InputError(f"no sequence '{sequence}' in {source}", valid=names[:20])


def parse_source(source: str) -> tuple[str, Path]:
    """Name and path of "NAME:PATH". Raises InputError."""
    name, colon, path = source.partition(":")
    if not colon or not path or name not in DATASETS:
        raise InputError(f"no data set '{source}'",
                         valid=f"NAME:PATH with a name of {', '.join(DATASETS)}")  # fmt: skip
    return name, Path(path)
