"""rig-correction.json: a search for errors of a rig, what it corrects and what remains unknown."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from egocap.cameras.rig import Rig
from egocap.errors import FileError
from egocap.files import write_json
from egocap.odometry.config import OdometryConfig
from egocap.odometry.self_calibration import PARAMETERS, Correction, RigSearch
from egocap.odometry.views import Views
from egocap.schema import Number, Strict, checked, read_json


class _File(Strict):
    """Without values nothing is corrected, without a covariance nothing was sought."""

    values: tuple[tuple[Number, ...], ...] = ()
    std: tuple[tuple[Number, ...], ...] = ()
    covariance: tuple[tuple[Number, ...], ...] = ()


def write_search(path: Path, search: RigSearch | None) -> None:
    """Write a search; None where none was made."""
    data: dict[str, Any] = {}
    if search is not None:
        data["covariance"] = search.covariance.tolist()
        if search.correction is not None:
            data |= {name: getattr(search.correction, name).tolist() for name in ("values", "std")}
    write_json(path, data)


def load_search(path: Path, rig: Rig) -> RigSearch | None:
    """The search for errors of a rig as it was given; None where none was made.

    Raises FileError, also for numbers of another rig.
    """
    found = checked(_File, read_json(path), path)
    if not found.covariance:
        return None
    views = Views.of(rig, OdometryConfig().width)
    each, size = (len(views), len(PARAMETERS)), len(views) * len(PARAMETERS)
    wanted = {"covariance": (size, size)}
    if found.values or found.std:
        wanted |= {"values": each, "std": each}
    for name, (rows, columns) in wanted.items():
        given = getattr(found, name)
        if len(given) != rows or any(len(row) != columns for row in given):
            raise FileError(path, "not of this rig", key=name, valid=f"{rows} x {columns} numbers")
    correction = None
    if found.values:
        correction = Correction.of(views, np.array(found.values), np.array(found.std))
    return RigSearch(correction, np.array(found.covariance))
