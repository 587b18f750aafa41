"""What takes long to make, kept in the user's cache under a hash of what it is made from.

The code and the libraries are part of the hash: another version makes it again. Files are pickles
that hold nothing but arrays and classes of the simulator, behind a checksum.
"""

from __future__ import annotations

import hashlib
import io
import json
import logging
import os
import pickle
import sys
import zlib
from collections.abc import Callable, Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

from egocap.errors import EgocapError
from egocap.files import cache_folder, make_folder, replacing
from egocap_sim.core.version import code_version

MOST_BYTES = 300_000_000  # of the folder; the longest unused go first
_LIBRARIES = ("numpy", "scipy", "numba", "opencv-contrib-python-headless")
_CHECKSUM = 4  # bytes in front of the pickle

T = TypeVar("T")
log = logging.getLogger(__name__)


def kept(kind: str, made_from: Mapping[str, Any], make: Callable[[], T]) -> T:
    """What `make` returns, from the cache if it was made before from the same values.

    `made_from` is JSON-ready, and all that the result depends on beside the code. Errors of `make`
    are raised and not kept. Without a writable cache it is made every time.
    """
    text = json.dumps([kind, made_from, _maker()], sort_keys=True)
    digest = hashlib.sha256(text.encode()).hexdigest()[:32]
    path = cache_folder() / "made" / f"{kind}-{digest}.pickle"
    try:
        return _read(path)
    except FileNotFoundError:
        pass
    except Exception as error:  # a damaged pickle raises all kinds
        log.warning("%s is damaged (%s); making it again", path, error)
    made = pickle.dumps(make(), protocol=5)
    try:
        make_folder(path.parent)
        _remove_unused(path.parent, MOST_BYTES - len(made))
        with replacing(path) as temporary:
            temporary.write_bytes(_checksum(made) + made)
    except (EgocapError, OSError) as error:  # only slower without a cache
        log.debug("%s cannot be kept: %s", kind, error)
    return _load(made)  # with the memory layout of later runs: the same bits


def _read(path: Path) -> Any:
    content = path.read_bytes()
    made = memoryview(content)[_CHECKSUM:]
    if _checksum(made) != content[:_CHECKSUM]:
        raise ValueError("its checksum differs")
    os.utime(path)
    return _load(made)


def _remove_unused(folder: Path, most_bytes: int) -> None:
    """Remove the files that were not used for the longest, until the others fit."""
    found = sorted((path.stat().st_mtime, path.stat().st_size, path)
                   for path in folder.glob("*.pickle"))  # fmt: skip
    left = sum(size for _, size, _ in found)
    for _, size, path in found:
        if left <= most_bytes:
            return
        path.unlink(missing_ok=True)
        left -= size


def _checksum(made: bytes | memoryview) -> bytes:
    return zlib.crc32(made).to_bytes(_CHECKSUM)


def _load(made: bytes | memoryview) -> Any:
    return _Reader(io.BytesIO(made)).load()


class _Reader(pickle.Unpickler):
    """Reads arrays and classes of the simulator, and nothing that runs other code."""

    def find_class(self, module: str, name: str) -> Any:
        numbers = module.split(".")[0] == "numpy" and name in _ARRAYS
        if not numbers and not module.startswith("egocap_sim."):
            raise pickle.UnpicklingError(f"{module}.{name} in it")
        found = super().find_class(module, name)
        if not numbers and not isinstance(found, type):
            raise pickle.UnpicklingError(f"{module}.{name} in it")
        return found


_ARRAYS = {"_frombuffer", "_reconstruct", "dtype", "ndarray", "scalar"}


@cache
def _maker() -> list[object]:
    """Versions of all that makes things, and the size and time of the table of body shapes."""
    shapes = Path(str(files("egocap_sim.human.body") / "adult_shapes.npz")).stat()
    return [code_version(), sys.version, [_version(name) for name in _LIBRARIES],
            shapes.st_size, shapes.st_mtime_ns]  # fmt: skip


def _version(library: str) -> str | None:
    try:
        return version(library)
    except PackageNotFoundError:  # installed under another name
        return None
