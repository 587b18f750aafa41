"""Sequences in; the formats of other tools, and contact sheets, out.

`FORMATS` names what writes each format.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from egocap.data.sequence import Sequence
from egocap.errors import InputError

Advance = Callable[[int], None]
Exporter = Callable[[Sequence, Path, Advance], None]


def export(
    sequence: Sequence, form: str, out: Path, on_frames: Advance = lambda frames: None
) -> None:
    """Write a sequence to `out` in one of FORMATS; `on_frames` hears of each frame done.

    Raises InputError for an unknown form and for an `out` that holds something already.
    """
    if form not in FORMATS:
        raise InputError(f"unknown format '{form}'", valid=FORMATS)
    FORMATS[form](sequence, out, on_frames)


def new_folder(out: Path) -> None:
    """Make the folder an export is written into; InputError where something is in it."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out} is not empty", valid="a new or an empty folder")
    out.mkdir(parents=True, exist_ok=True)


def _coco(sequence: Sequence, out: Path, on_frames: Advance) -> None:
    from egocap_sim.export.coco import write_coco

    write_coco(sequence, out, on_frames)


def _unrealego(sequence: Sequence, out: Path, on_frames: Advance) -> None:
    from egocap_sim.export.unrealego import write_unrealego

    write_unrealego(sequence, out, on_frames)


def _mp4(sequence: Sequence, out: Path, on_frames: Advance) -> None:
    from egocap_sim.export.mp4 import write_mp4

    write_mp4(sequence, out, on_frames)


FORMATS: dict[str, Exporter] = {"coco": _coco, "unrealego": _unrealego, "mp4": _mp4}
"""Name of a format -> what writes it; each is imported when it is used."""
