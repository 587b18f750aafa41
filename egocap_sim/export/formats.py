"""The export formats by name."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from egocap.data.sequence import Sequence
from egocap.errors import InputError

FORMATS = ("coco", "unrealego", "mp4", "videos")
"""Each is written by the function `write_NAME` of the module `egocap_sim.export.NAME`."""


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
    module = import_module(f"egocap_sim.export.{form}")  # without the packages of the others
    getattr(module, f"write_{form}")(sequence, out, on_frames)


def new_folder(out: Path) -> None:
    """Create the folder of an export. Raises InputError if it exists and is not empty."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out} is not empty", valid="a new or an empty folder")
    out.mkdir(parents=True, exist_ok=True)
