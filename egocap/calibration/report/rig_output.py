"""Write a calibrated rig: TOML for people, JSON with the same digits for programs."""

from __future__ import annotations

from pathlib import Path

from egocap.cameras.rig import Rig
from egocap.cameras.rig_files import format_rig
from egocap.errors import InputError
from egocap.files import write_atomically

FORMATS = (".toml", ".json")


def check_rig_name(path: Path) -> None:
    """Raise InputError unless a rig can be written under this name."""
    if path.suffix.lower() not in FORMATS:
        raise InputError(f"cannot write the rig '{path.name}'",
                         valid="a name that ends in .toml or .json")  # fmt: skip


def write_rig(path: Path, rig: Rig, notes: tuple[str, ...] = ()) -> None:
    """Write a rig with all digits. `notes` stand at the top of a TOML file.

    Raises as `check_rig_name` and `egocap.files.disk_errors`.
    """
    check_rig_name(path)
    if path.suffix.lower() == ".json":
        rig.to_json(path)
        return
    head = "".join(f"# {line}\n" for line in notes)
    write_atomically(path, head + format_rig(rig))
