"""Images of data sets where they lie: files, members of zip archives, rows of HDF5 data sets."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from egocap.cameras.camera import Camera
from egocap.errors import FileError, require
from egocap.files import read_bytes
from egocap.media.decoding import decode

SUFFIXES = (".png", ".jpg", ".jpeg")


@dataclass(frozen=True)
class Picture:
    """One image. `member` names it inside an archive, or the data set of an HDF5 file."""

    path: Path
    member: str = ""
    row: int | None = None  # of the HDF5 data set (rows, 3, height, width)
    mirrored: bool = False  # stored left-right mirrored

    def read(self, camera: Camera | None = None) -> UInt8[Array, "H W 3"]:
        """Decode the image, RGB. Raises FileError, also for another size than the camera's."""
        image = self._decoded() if self.row is None else self._row()
        image = np.ascontiguousarray(image[:, ::-1] if self.mirrored else image)
        if camera is not None and image.shape[:2] != (camera.height, camera.width):
            size = f"{image.shape[1]} x {image.shape[0]} pixels"
            valid = f"{camera.width} x {camera.height}, as the calibration"
            raise FileError(self.path, f"an image of {size}", key=self.member or None, valid=valid)
        return image

    def _decoded(self) -> Any:
        import cv2

        image = decode(self.content(), cv2.IMREAD_COLOR_RGB, self.path)
        if image is None:
            raise FileError(self.path, "not an image, or damaged", key=self.member or None)
        return image

    def content(self) -> bytes:
        """The image file's bytes. Raises FileError."""
        if self.member:
            return read_member(self.path, self.member)
        return read_bytes(self.path)

    def _row(self) -> Any:
        with open_hdf5(self.path) as file:
            return np.moveaxis(file[self.member][self.row], 0, -1)


def open_hdf5(path: Path) -> Any:
    """Open an HDF5 file for reading. Raises MachineError without h5py, FileError for others."""
    require("h5py", "datasets")
    import h5py

    try:
        return h5py.File(path, "r")
    except OSError as error:
        raise FileError(path, f"not an HDF5 file: {str(error)[:80]}") from None


@lru_cache(maxsize=8)
def open_archive(path: Path) -> zipfile.ZipFile:
    """Open a zip archive, once. Raises FileError."""
    try:
        return zipfile.ZipFile(path)
    except (OSError, zipfile.BadZipFile) as error:
        raise FileError(path, f"not a zip archive: {error}") from None


def read_member(path: Path, member: str) -> bytes:
    """Content of a file inside a zip archive. Raises FileError."""
    try:
        return open_archive(path).read(member)
    except KeyError:
        raise FileError(path, "no such file in the archive", key=member) from None
    except (OSError, RuntimeError, zipfile.BadZipFile) as error:
        raise FileError(path, f"damaged: {error}", key=member) from None


class Tree:
    """A folder, or the zip archive `folder.zip` where the folder is absent, as one tree of files.

    A folder of the archive's own name inside it is not part of the names. Raises FileError where
    neither exists.
    """

    def __init__(self, folder: Path) -> None:
        archive = folder if folder.suffix == ".zip" else folder.with_name(folder.name + ".zip")
        self.path = folder if folder.is_dir() else archive
        if not self.path.exists():
            raise FileError(folder, "neither this folder nor its .zip exists")
        self._members: dict[str, str] = {}
        if self.path.is_file():
            for name in open_archive(self.path).namelist():
                self._members[name.removeprefix(f"{self.path.stem.split('.')[0]}/")] = name

    def names(self, folder: str) -> Iterator[str]:
        """Names of the files in a folder of the tree, not in its subfolders."""
        prefix = f"{folder}/" if folder else ""
        if self._members:
            rest = (name for name in self._members if name.startswith(prefix))
            yield from (name for name in rest if name != prefix and "/" not in name[len(prefix) :])
        elif (self.path / folder).is_dir():
            yield from (prefix + path.name for path in (self.path / folder).iterdir())

    def read(self, name: str) -> bytes:
        """Content of a file. Raises FileError."""
        return self.picture(name).content()

    def text(self, name: str) -> str:
        """A text file. Raises FileError."""
        return self.read(name).decode("utf-8", "replace")

    def picture(self, name: str, *, mirrored: bool = False) -> Picture:
        """An image of the tree; it need not exist."""
        if self._members:
            return Picture(self.path, self._members.get(name, name), mirrored=mirrored)
        return Picture(self.path / name, mirrored=mirrored)

    def where(self, name: str) -> Path:
        """Path of a file, for errors."""
        return self.path / name


def last_number(name: str) -> int | None:
    """The last number in a file's name without its suffix; None where there is none."""
    found = re.findall(r"\d+", Path(name).stem)
    return int(found[-1]) if found else None


def numbered(folder: Path, suffixes: tuple[str, ...] = SUFFIXES) -> dict[int, Path]:
    """Files of a folder by the last number in their names, in its order. Raises FileError for two
    files of one number."""
    found: dict[int, Path] = {}
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        number = last_number(path.name)
        if path.suffix.lower() in suffixes and number is not None:
            if number in found:
                raise FileError(path, f"has the same frame number as {found[number].name}")
            found[number] = path
    return dict(sorted(found.items()))
