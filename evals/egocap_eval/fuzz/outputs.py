"""What a disturbed command has left in its folder: names of files, and those that are broken."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from egocap.errors import EgocapError, InputError
from egocap.files import read_npz
from egocap.schema import read_json, read_toml


def names(folder: Path) -> set[str]:
    """Relative paths of the files; those of a cache by their folder, since it is named by hash."""
    found = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    return {str(Path(*p.parts[:3]) if "views" in p.parts else p) for p in found}


def broken_files(folder: Path) -> Iterator[str]:
    """Files under final names that cannot be read."""
    readers: dict[str, Callable[[Path], Any]] = {
        ".npz": read_npz, ".json": read_json, ".toml": read_toml,
        ".safetensors": partial(_starts, b""), ".glb": partial(_starts, b"glTF"),
        ".html": partial(_starts, b"<"), ".tar": partial(_starts, b""),
    }  # fmt: skip
    for path in sorted(folder.rglob("*")):
        hidden = any(part.startswith(".") or part.endswith((".tmp", ".part"))
                     for part in path.relative_to(folder).parts)  # fmt: skip
        if path.suffix in readers and path.is_file() and not hidden:
            try:
                readers[path.suffix](path)
            except EgocapError as error:
                yield f"a broken file: {error!s:.160}"


def _starts(magic: bytes, path: Path) -> None:
    content = path.read_bytes()
    if not content.startswith(magic) or not content:
        raise InputError(f"{path} begins with {content[:8]!r}")
