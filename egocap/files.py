"""Atomic writing of files, reading and writing of npz archives, and errors of the file system.

Paths in; bytes and arrays out. Every result file of the project is written through here.
"""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
import re
import zipfile
import zlib
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from tokenize import TokenError
from typing import IO, Any

import numpy as np
from numpy import ndarray as Array

from egocap.errors import FileError, MachineError

MOST_BYTES = 1 << 28
"""Of a file that is read at once."""

MOST_ARRAYS = 1000
"""In one npz archive."""

ALWAYS_UNPACKED, MOST_RATIO = 1 << 28, 32
"""An npz archive may unpack to the first, in bytes, or to this multiple of its own size."""

LARGEST = 1e12
"""Magnitude of numbers in results: squares of larger ones overflow further on."""

_DAMAGE = (ArithmeticError, ValueError, OSError, EOFError, MemoryError, RuntimeError, SyntaxError,
           TypeError, TokenError, zipfile.BadZipFile, zlib.error)  # fmt: skip
_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0}  # fmt: skip


@contextmanager
def replacing(path: Path, *, keep_suffix: bool = False) -> Iterator[Path]:
    """Yield a temporary path to write to; it replaces `path` when the block succeeds.

    The replacement is atomic. The temporary file belongs to this process and is removed on an
    error. `keep_suffix` gives it the suffix of `path`, for writers that choose the format by it.
    Raises as `disk_errors`.
    """
    ending = f"tmp{path.suffix}" if keep_suffix else "tmp"
    temporary = path.with_name(f".{path.name}.{os.getpid()}.{ending}")
    with disk_errors(path):
        try:
            temporary.unlink(missing_ok=True)  # so that no link there is followed
            yield temporary
            with temporary.open("rb") as file:
                os.fsync(file.fileno())
            temporary.replace(path)
        except BaseException:
            temporary.unlink(missing_ok=True)  # frees its space on a full disk
            raise


def remove_temporary(folder: Path, name: str | None = None) -> None:
    """Remove what killed processes have left of `replacing` files of that name, or of any.

    Only for who holds the lock of the output.
    """
    pattern = rf"\.{re.escape(name) if name else '.+'}\.\d+\.tmp(\.\w+)?"
    for path in folder.iterdir():
        if re.fullmatch(pattern, path.name) and not path.is_dir():
            path.unlink(missing_ok=True)


def write_atomically(path: Path, content: bytes | str) -> None:
    """Replace a file's content atomically; text is written as UTF-8. Raises as `disk_errors`."""
    with replacing(path) as temporary:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)


def write_json(path: Path, data: Any) -> None:
    """Write indented JSON atomically. Raises as `disk_errors`."""
    write_atomically(path, json.dumps(data, indent=1) + "\n")


def make_folder(folder: Path) -> None:
    """Make a folder and its missing parents. Raises as `disk_errors`."""
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)


@contextmanager
def disk_errors(path: Path) -> Iterator[None]:
    """Turn an OSError into a MachineError or FileError with a message for the user."""
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise MachineError(
                f"{path}: the disk is full", remedy="free some space and run the same command again"
            ) from None
        if isinstance(error, FileNotFoundError) and not path.parent.is_dir():
            raise MachineError(f"cannot write {path}: no such folder") from None
        if isinstance(error, FileNotFoundError) and _beside(error.filename, path):
            raise MachineError(f"cannot write {path}: no files can be made in its folder") from None
        if error.errno in (errno.EACCES, errno.EROFS, errno.EPERM):
            raise MachineError(f"{path}: no permission to write there") from None
        if isinstance(error, (NotADirectoryError, FileExistsError)):
            raise FileError(path, "is not a folder, or lies in none") from None
        if isinstance(error, IsADirectoryError):
            raise FileError(path, "is a folder", valid="the name of a file") from None
        raise


def _beside(name: object, path: Path) -> bool:
    """Whether a file of an error lies in the folder of a path, as its temporary file does."""
    return isinstance(name, str | os.PathLike) and Path(name).parent == path.parent


def sha256(path: Path) -> str:
    """SHA-256 of a file's content. Raises FileError where it cannot be read."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror}") from None


def read_bytes(path: str | Path, limit: int = MOST_BYTES) -> bytes:
    """Content of a file. Raises FileError where it cannot be read or has more bytes than that.

    Nothing beyond the limit is read: devices have no end and no size.
    """
    try:
        with Path(path).open("rb") as file:
            size = os.fstat(file.fileno()).st_size  # 0 of a device
            content = b"" if size > limit else file.read(limit + 1)
    except FileNotFoundError:
        raise FileError(path, "no such file") from None
    except IsADirectoryError:
        raise FileError(path, "is a folder", valid="a file") from None
    except (OSError, ValueError) as error:
        raise FileError(path, f"cannot be read: {getattr(error, 'strerror', error)}") from None
    if max(size, len(content)) > limit:
        found = f"{size:,}" if size > limit else f"more than {limit:,}"
        raise FileError(path, f"has {found} bytes", valid=f"at most {limit:,}")
    return content


def cache_folder() -> Path:
    """Folder of cached files: $XDG_CACHE_HOME/egocap or ~/.cache/egocap."""
    root = os.environ.get("XDG_CACHE_HOME")
    return (Path(root) if root else Path.home() / ".cache") / "egocap"


def write_npz(path: Path, *, compressed: bool = True, **arrays: Any) -> None:
    """Write named arrays as npz atomically; None is omitted. Raises as `disk_errors`."""
    present = {name: value for name, value in arrays.items() if value is not None}
    save = np.savez_compressed if compressed else np.savez
    with replacing(path) as temporary, temporary.open("wb") as file:
        save(file, **present)


def read_npz(path: Path, only: Collection[str] | None = None) -> dict[str, Array]:
    """Read the arrays of an npz file, or only those named in `only`.

    The archive's directory and the arrays' headers are checked before anything is allocated.
    Raises FileError unless the file is a complete archive of plain arrays within the limits.
    """
    if not path.is_file():
        raise FileError(path, "is a folder" if path.is_dir() else "no such file")
    try:
        with zipfile.ZipFile(path) as archive:
            members = _members(archive, path.stat().st_size)
            chosen = {n: info for n, info in members.items() if only is None or n in only}
            return {name: _array(archive, info) for name, info in chosen.items()}
    except _DAMAGE as error:
        detail = f": {error!s:.200}" if str(error) else ""
        raise FileError(path, f"not a whole npz archive of plain arrays{detail}") from None


def map_npy(path: Path, shape: tuple[int, ...], dtype: type[np.generic]) -> Array:
    """A memory map of a .npy file. Raises FileError unless it holds an array of that shape."""
    try:
        with path.open("rb") as file:
            _check_header(file, path.name, path.stat().st_size)
        array = np.load(path, mmap_mode="r" if math.prod(shape) else None, allow_pickle=False)
    except _DAMAGE as error:
        raise FileError(path, f"not a whole array: {error!s:.200}") from None
    if (array.shape, array.dtype) != (shape, dtype):
        raise FileError(path, f"has type {array.dtype}, shape {array.shape}",
                        valid=f"{dtype.__name__}, {shape}")  # fmt: skip
    return array


def usable(values: Array) -> Array:
    """Where numbers are finite and no larger than LARGEST."""
    return np.abs(values) <= LARGEST  # False for NaN


def _members(archive: zipfile.ZipFile, size: int) -> dict[str, zipfile.ZipInfo]:
    """The members by array name. Raises ValueError for what no npz archive of ours holds."""
    infos = archive.infolist()
    if len(infos) > MOST_ARRAYS:
        raise ValueError(f"{len(infos)} members, at most {MOST_ARRAYS}")
    unpacked, limit = sum(i.file_size for i in infos), max(ALWAYS_UNPACKED, MOST_RATIO * size)
    if unpacked > limit:
        raise ValueError(f"unpacks to {unpacked:,} bytes, at most {limit:,}")
    for info in infos:
        if not info.filename.endswith(".npy"):
            raise ValueError(f"{info.filename!r:.80} is not an array (.npy)")
        if info.flag_bits & 1:
            raise ValueError(f"{info.filename!r:.80} is encrypted")
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise ValueError(f"{info.filename!r:.80} has compression {info.compress_type}")
    members = {info.filename.removesuffix(".npy"): info for info in infos}
    if len(members) < len(infos):
        raise ValueError("two members of one name")
    return members


def _array(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> Array:
    """One array; its header must state exactly the bytes that the member has."""
    with archive.open(info) as member:
        _check_header(member, info.filename, info.file_size)
    with archive.open(info) as member:
        return np.lib.format.read_array(member, allow_pickle=False)


def _check_header(file: IO[bytes], name: str, size: int) -> None:
    """Read the header of an array of `size` bytes with it. Raises ValueError, or as numpy does."""
    version = np.lib.format.read_magic(file)
    if version not in _HEADERS:
        raise ValueError(f"{name!r:.80} has .npy version {version}")
    shape, _, dtype = _HEADERS[version](file)
    if dtype.kind not in "biufU" or not dtype.itemsize or min(shape, default=0) < 0:
        raise ValueError(f"{name!r:.80} has type {dtype!s:.80}, shape {shape!s:.80}")
    if math.prod(shape) * dtype.itemsize != size - file.tell():
        raise ValueError(f"{name!r:.80} has not the size of its shape {shape!s:.80}")
