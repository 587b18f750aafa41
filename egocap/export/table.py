"""A track as CSV: a row a frame, with units in the names of the columns.

Joints are in metres in the world or head frame, as their names say; angles are in degrees.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from egocap.body.labels import LABELS
from egocap.body.skeleton import DOFS
from egocap.data.track import Track
from egocap.export.markers import joints_known
from egocap.files import write_atomically


def write_table(path: Path, track: Track) -> None:
    """Write a track as CSV, atomically; an unknown value is left empty.

    Raises as `egocap.files.disk_errors`.
    """
    joints, frame = joints_known(track)
    count = len(track.times)
    columns = [track.times[:, None], joints.reshape(count, -1), np.rad2deg(track.angles)]
    names = ["time_s", *(f"{frame}_{label}_{axis}_m" for label in LABELS for axis in "xyz"),
             *(f"{angle}_deg" for angle in DOFS)]  # fmt: skip
    if track.covariance is not None:
        columns.append(np.sqrt(np.trace(track.covariance, axis1=2, axis2=3) / 3))
        names += [f"{label}_sigma_m" for label in LABELS]
    if track.confidence is not None:
        columns.append(track.confidence)
        names += [f"{label}_confidence" for label in LABELS]
    rows = [
        ",".join("" if np.isnan(value) else f"{value:.6f}" for value in row)
        for row in np.concatenate(columns, axis=1)
    ]
    write_atomically(path, "\n".join([",".join(names), *rows]) + "\n")
