"""Files written whole or not at all, npz archives read with care, and the disk's errors explained.

Paths in; bytes and arrays out. Everything the project writes for keeps goes through here.
"""

from __future__ import annotations

import errno
import os
import zipfile
import zlib
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray as Array

from egocap.errors import FileError, MachineError


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path to write to; it takes the place of `path` when the block succeeds.

    A reader, or a kill, finds the old content or the new, whole. The temporary file, which no other
    process shares, is removed on an error. Raises as `disk_errors`.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    with disk_errors(path):
        try:
            yield temporary
            with temporary.open("rb") as file:
                os.fsync(file.fileno())
            temporary.replace(path)
        except BaseException:
            temporary.unlink(missing_ok=True)  # on a full disk it would keep the space
            raise


def write_atomically(path: Path, content: bytes | str) -> None:
    """Replace a file's content in one step; text is written as UTF-8. Raises as `disk_errors`."""
    with replacing(path) as temporary:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)


def make_folder(folder: Path) -> None:
    """Make a folder and those above it, where they are missing. Raises as `disk_errors`."""
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)


@contextmanager
def disk_errors(path: Path) -> Iterator[None]:
    """Turn an OSError into a MachineError or FileError that a user can act on."""
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise MachineError(
                f"{path}: the disk is full", remedy="free some space and run the same command again"
            ) from None
        if isinstance(error, FileNotFoundError) and not path.parent.is_dir():
            raise MachineError(f"cannot write {path}: no such folder") from None
        if error.errno in (errno.EACCES, errno.EROFS, errno.EPERM):
            raise MachineError(f"{path}: no permission to write there") from None
        if isinstance(error, (NotADirectoryError, FileExistsError)):
            raise FileError(path, "is not a folder, or lies in none") from None
        if isinstance(error, IsADirectoryError):
            raise FileError(path, "is a folder", valid="the name of a file") from None
        raise


def cache_folder() -> Path:
    """Where EgoCap keeps what it can make again: $XDG_CACHE_HOME/egocap or ~/.cache/egocap."""
    root = os.environ.get("XDG_CACHE_HOME")
    return (Path(root) if root else Path.home() / ".cache") / "egocap"


def write_npz(path: Path, *, compressed: bool = True, **arrays: Any) -> None:
    """Write named arrays as npz, whole or not at all; None is left out. Raises as `disk_errors`."""
    present = {name: value for name, value in arrays.items() if value is not None}
    save = np.savez_compressed if compressed else np.savez
    with replacing(path) as temporary, temporary.open("wb") as file:
        save(file, **present)


def read_npz(path: Path, only: Collection[str] | None = None) -> dict[str, Array]:
    """The arrays of an npz file, or those of the names in `only` that it has.

    Raises FileError unless the file is a whole archive of plain arrays.
    """
    if not path.is_file():
        raise FileError(path, "is a folder" if path.is_dir() else "no such file")
    try:
        if not zipfile.is_zipfile(path):  # np.load would take other kinds of file too
            raise ValueError
        with np.load(path, allow_pickle=False) as archive:
            return {n: archive[n] for n in archive.files if only is None or n in only}
    except (ValueError, OSError, EOFError, KeyError, AttributeError, NotImplementedError,
            RuntimeError, zipfile.BadZipFile, zlib.error) as error:  # fmt: skip
        detail = f": {error}" if str(error) else ""
        raise FileError(path, f"not a whole npz archive of plain arrays{detail}") from None
