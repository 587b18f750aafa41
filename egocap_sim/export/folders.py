"""Output folders of exports."""

from __future__ import annotations

from pathlib import Path

from egocap.errors import InputError


def new_folder(out: Path) -> None:
    """Create the folder of an export. Raises InputError if it holds something already."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out} is not empty", valid="a new or an empty folder")
    out.mkdir(parents=True, exist_ok=True)
