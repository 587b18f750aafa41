"""The formats of `egocap export`, by name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from egocap.data.bvh import write_bvh
from egocap.data.resampling import evenly
from egocap.data.track import Track, write_arrays
from egocap.export.c3d import write_c3d
from egocap.export.glb import write_glb
from egocap.export.smpl import write_smpl
from egocap.export.table import write_table
from egocap.export.trc import write_trc


def _write_bvh(path: Path, track: Track) -> None:
    write_bvh(path, evenly(track))


FORMATS: dict[str, Callable[[Path, Track], None]] = {
    "bvh": _write_bvh,
    "glb": write_glb,
    "c3d": write_c3d,
    "trc": write_trc,
    "csv": write_table,
    "npz": write_arrays,
    "smpl": write_smpl,
}
"""Writers of a track; the name is also the file's suffix, but for smpl, an .npz."""
