"""The export formats by name."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from egocap.data.sequence import Sequence
from egocap.errors import InputError
from egocap.files import make_folder

FORMATS = ("coco", "unrealego", "mp4", "videos", "head-pose", "imu")
"""Each is written by the function `write_NAME` of the module `egocap_sim.export.NAME`, with a low
line for a hyphen."""
ENDINGS = {"mp4": ".mp4", "head-pose": ".npz", "imu": ".csv"}
"""Of the formats that are one file; the others are folders."""


def export(
    sequence: Sequence,
    form: str,
    out: Path,
    on_frames: Callable[[int], None] = lambda frames: None,
) -> None:
    """Write a sequence to `out` in one of FORMATS; `on_frames` is called with 1 for each frame.

    Raises InputError for an unknown format and for an `out` that is not empty.
    """
    if form not in FORMATS:
        raise InputError(f"unknown format '{form}'", valid=FORMATS)
    name = form.replace("-", "_")
    module = import_module(f"egocap_sim.export.{name}")  # without the packages of the others
    getattr(module, f"write_{name}")(sequence, out, on_frames)


def new_folder(out: Path) -> None:
    """Create the folder of an export. Raises InputError if it exists and is not empty."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out} is not empty", valid="a new or an empty folder")
    out.mkdir(parents=True, exist_ok=True)


def new_file(out: Path, ending: str) -> None:
    """Create the folder of a file to write. Raises InputError for a name of another ending."""
    if out.suffix != ending:
        raise InputError(f"{out.name}", valid=f"a name that ends in {ending}")
    make_folder(out.parent)
