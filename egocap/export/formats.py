"""The formats of `egocap export`, by name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from egocap.data.bvh import write_bvh
from egocap.data.resampling import evenly
from egocap.data.track import Track, write_arrays
from egocap.errors import InputError
from egocap.export.c3d import write_c3d
from egocap.export.glb import write_glb
from egocap.export.smpl import write_smpl
from egocap.export.table import write_table
from egocap.export.trc import write_trc
from egocap.export.usd import write_usd


def _write_bvh(path: Path, track: Track) -> None:
    write_bvh(path, evenly(track))


FORMATS: dict[str, Callable[[Path, Track], None]] = {
    "bvh": _write_bvh,
    "glb": write_glb,
    "usda": write_usd,
    "c3d": write_c3d,
    "trc": write_trc,
    "csv": write_table,
    "npz": write_arrays,
    "smpl": write_smpl,
}
"""Writers of a track; the name is also the file's suffix, but for smpl, .smpl.npz."""

_MODELS = ("smpl", "amass")  # in a name: its user expects parameters of a body model


def format_of(path: Path) -> str:
    """The format that a file's name tells, in `FORMATS`. Raises InputError where it does not."""
    name = path.name.lower()
    if name.endswith(".smpl.npz"):
        return "smpl"
    found = path.suffix.removeprefix(".").lower()
    if found == "npz" and any(model in name for model in _MODELS):
        raise InputError(
            f"'{path.name}' may mean plain arrays or parameters of SMPL-X",
            valid="a name that ends in .smpl.npz; --format smpl; --format npz",
        )
    if found == "smpl" or found not in FORMATS:
        suffixes = [name if name != "smpl" else "smpl.npz" for name in FORMATS]
        raise InputError(f"cannot tell the format of '{path.name}'", valid=suffixes)
    return found
