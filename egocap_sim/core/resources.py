"""Where the files that come with the program are: the one place that knows.

In a checkout they lie in `scenes/` at the root; a wheel carries the same folder inside the package.
"""

from __future__ import annotations

from pathlib import Path

from egocap.errors import InputError

KINDS: dict[str, str] = {"scene": ".", "rig": "rigs"}
"""Kinds of built-in files, and their folder under scenes/."""
SAMPLED = "sampled"
"""Rig name without a file: the rig is drawn from the scene's seed."""


def builtin_folder() -> Path:
    """The folder of the built-in scenes."""
    package = Path(__file__).resolve().parents[1]
    inside = package / "scenes"
    return inside if inside.is_dir() else package.parent / "scenes"


def builtin_names(kind: str) -> tuple[str, ...]:
    """Names of the built-in files of a kind ('scene' or 'rig'), sorted."""
    return tuple(sorted(p.stem for p in (builtin_folder() / KINDS[kind]).glob("*.toml")))


def builtin_file(kind: str, name: str) -> Path:
    """Path of a built-in file. Raises InputError with the valid names."""
    if name not in builtin_names(kind):
        raise InputError(f"no built-in {kind} '{name}'", valid=builtin_names(kind))
    return builtin_folder() / KINDS[kind] / f"{name}.toml"


def rig_names() -> tuple[str, ...]:
    """Valid names of rigs: the built-in ones and SAMPLED."""
    return (*builtin_names("rig"), SAMPLED)


def rig_file(name: str) -> Path:
    """Path of a built-in rig's file. Raises InputError with all valid names of rigs."""
    if name not in builtin_names("rig"):
        raise InputError(f"no rig '{name}'", valid=rig_names())
    return builtin_file("rig", name)


def find_file(kind: str, name_or_path: str | Path) -> Path:
    """Find a file by its path or by the name of a built-in one.

    Text with a suffix or a slash, or the name of an existing file, is a path. Raises InputError for
    an unknown name.
    """
    path = Path(name_or_path)
    if path.suffix or len(path.parts) > 1 or path.exists():
        return path
    return builtin_file(kind, str(name_or_path))
