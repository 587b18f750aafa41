"""Calibration files of data sets: beside the data, or shipped where their licence allows."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from egocap.cameras.camera import Camera
from egocap.cameras.camera_files import load_camera
from egocap.datasets.fields import upwards
from egocap.errors import FileError

SHIPPED = Path(__file__).parent / "calibrations"


def find_camera(folder: Path, names: Collection[str], source: str) -> Camera:
    """The camera of the first file of these names in `folder` or above it, else a shipped one.

    `source` says where the data set's owners publish it. Raises FileError where there is none.
    """
    path = upwards(folder, names)
    if path is None:
        path = next((SHIPPED / name for name in names if (SHIPPED / name).is_file()), None)
    if path is None:
        problem = f"no calibration; copy it here or to a folder above from {source}"
        raise FileError(folder, problem, valid=names)
    return load_camera(path)
