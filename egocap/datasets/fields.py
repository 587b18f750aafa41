"""Checked values of other people's JSON and pickled records; errors name the file and the key."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.errors import FileError
from egocap.files import usable


def item(data: Any, path: Path, *keys: str) -> Any:
    """The value at nested keys. Raises FileError naming the first missing key."""
    for depth, key in enumerate(keys):
        if not isinstance(data, dict) or key not in data:
            valid = [str(name) for name in data][:20] if isinstance(data, dict) else None
            raise FileError(path, "missing; another version of the data set?",
                            key=".".join(keys[: depth + 1]), valid=valid)  # fmt: skip
        data = data[key]
    return data


def array(
    data: Any, path: Path, *keys: str, shape: tuple[int | None, ...]
) -> Float[Array, "*shape"]:
    """The array at nested keys, float64; None in `shape` is a free axis. Raises FileError."""
    value = item(data, path, *keys)
    try:
        found = np.asarray(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        raise FileError(path, "not an array of numbers", key=".".join(keys)) from None
    fits = found.ndim == len(shape) and all(
        want in (None, got) for want, got in zip(shape, found.shape, strict=True)
    )
    if not fits or not usable(found).all():
        problem = (f"has shape {found.shape}" if not fits
                   else "holds values that are not finite, or too large")  # fmt: skip
        sizes = ", ".join("any" if size is None else str(size) for size in shape)
        raise FileError(path, problem, key=".".join(keys) or None, valid=f"({sizes})")
    return found


def folders_with(root: Path, names: Collection[str]) -> Iterator[Path]:
    """Folders at or below `root` that hold an entry of one of these names, sorted.

    Nothing is searched below a folder that was found. Raises FileError for a missing root.
    """
    if not root.is_dir():
        raise FileError(root, "no such folder")
    for folder, inside, files in os.walk(root):
        inside.sort()
        if set(names) & {*inside, *files}:
            inside.clear()
            yield Path(folder)


def upwards(folder: Path, names: Collection[str]) -> Path | None:
    """The first file of these names in `folder` or a folder above it; None where there is none."""
    for place in (folder, *folder.absolute().parents):
        for name in names:
            if (place / name).is_file():
                return place / name
    return None
