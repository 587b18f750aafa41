"""Joints as TRC, the marker file of OpenSim: millimetres; x forward, y up, z to the right.

Source: OpenSim documentation, "Marker (.trc) files"; OpenSim's ground frame has y up.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from egocap.data.track import Track
from egocap.export.markers import joint_markers
from egocap.files import write_atomically

_TO_FILE = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""Axes of the project (x forward, y left, z up) to those of the file."""


def write_trc(path: Path, track: Track) -> None:
    """Write a track as TRC, atomically; an unknown point is left blank.

    Raises InputError for times that do not increase, and as `egocap.files.disk_errors`.
    """
    markers = joint_markers(track)
    count, number = len(markers.times), len(markers.names)
    rate = f"{markers.fps:.6f}"
    coordinates = [f"{axis}{i + 1}" for i in range(number) for axis in "XYZ"]
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\t"
        "OrigNumFrames",
        f"{rate}\t{rate}\t{count}\t{number}\tmm\t{rate}\t1\t{count}",
        "Frame#\tTime\t" + "\t\t\t".join(markers.names) + "\t\t",
        "\t\t" + "\t".join(coordinates),
        "",
    ]
    points = 1000.0 * markers.points @ _TO_FILE.T
    for i, (time, row) in enumerate(zip(markers.times, points, strict=True)):
        cells = ["" if np.isnan(value) else f"{value:.4f}" for value in row.ravel()]
        lines.append("\t".join([str(i + 1), f"{time - markers.times[0]:.6f}", *cells]))
    write_atomically(path, "\n".join(lines) + "\n")
