"""Folders of picture files: one a frame, in the order of the numbers at the end of their names.

8 or 16 bits, grey, colour or raw Bayer mosaics. A number that is missing is a frame that is.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.errors import FileError, InputError
from egocap.files import read_bytes
from egocap.media.decoding import decode

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm", ".ppm")
UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
Bayer = Literal["RGGB", "BGGR", "GRBG", "GBRG"]


@dataclass(frozen=True)
class PictureOptions:
    """How the files of a folder are read; videos need none of it."""

    fps: float | None = None
    """Frames per second of folders of pictures, whose names count the frames."""
    stamp: Literal["s", "ms", "us", "ns"] | None = None
    """Unit of the times in the names of pictures, where they hold times instead of counting."""
    bits: int = 16
    """Significant bits of 16-bit pictures."""
    bayer: Bayer | None = None
    """Colours of the first two rows of raw mosaics."""

    def __post_init__(self) -> None:
        if self.fps is not None and not 0.001 <= self.fps <= 10_000.0:
            raise InputError(f"--fps {self.fps:g}", valid="0.001 to 10000")
        if not 8 <= self.bits <= 16:
            raise InputError(f"--bits {self.bits}", valid="8 to 16")


class PictureFolder:
    """A folder of pictures, open for reading.

    Raises FileError for a folder without pictures, names without numbers, equal numbers, or where
    neither a rate nor a unit of times is given.
    """

    def __init__(self, path: str | Path, options: PictureOptions | None = None) -> None:
        self.path, self.options = Path(path), options or PictureOptions()
        self.files, numbers = _numbered(self.path)
        self.first_number = numbers[0]
        self.times: Float[Array, "N"] = _times(self.path, numbers, self.options)
        first = next((image for image in map(self._read, self.files) if image is not None), None)
        if first is None:
            raise FileError(self.path, "holds no picture that can be decoded")
        self.size = (first.shape[1], first.shape[0])

    def __repr__(self) -> str:
        width, height = self.size
        return f"PictureFolder('{self.path}', {width} x {height}, {len(self.times)} pictures)"

    def frames(self) -> Iterator[tuple[float, UInt8[Array, "H W 3"]]]:
        """Time [s] and RGB image of every picture that can be decoded, in order."""
        for index, time in enumerate(self.times):
            image = self.image(index)
            if image is not None:
                yield float(time), image

    def image(self, index: int) -> UInt8[Array, "H W 3"] | None:
        """RGB image of a picture, by its place in `times`; None where it is damaged.

        Raises FileError for one of another size than the first.
        """
        image = self._read(self.files[index])
        if image is not None and (image.shape[1], image.shape[0]) != self.size:
            raise FileError(self.files[index], f"is {image.shape[1]} x {image.shape[0]}",
                            valid=f"{self.size[0]} x {self.size[1]}, as the first")  # fmt: skip
        return image

    def close(self) -> None:
        """Nothing is open between reads."""

    def _read(self, path: Path) -> UInt8[Array, "H W 3"] | None:
        import cv2

        picture = decode(read_bytes(path), cv2.IMREAD_UNCHANGED, path)
        return None if picture is None else _rgb(picture, path, self.options)


def open_pictures(path: str | Path, options: PictureOptions | None = None) -> PictureFolder:
    """Open a folder of pictures. Raises FileError."""
    return PictureFolder(path, options)


def _numbered(folder: Path) -> tuple[list[Path], list[int]]:
    """Picture files and the numbers at the end of their names, in the order of these."""
    found: dict[int, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() not in SUFFIXES or path.name.startswith("."):  # macOS' ._1.png
            continue
        number = re.search(r"(\d+)\D*$", path.stem)
        if number is None:
            raise FileError(path, "its name holds no number", valid="e.g. 000123.png")
        if int(number[1]) in found:
            raise FileError(path, f"has the number of {found[int(number[1])].name}")
        found[int(number[1])] = path
    if not found:
        raise FileError(folder, "holds no pictures", valid=", ".join(SUFFIXES))
    return [found[n] for n in sorted(found)], sorted(found)


def _times(folder: Path, numbers: list[int], options: PictureOptions) -> Float[Array, "N"]:
    away = np.array([n - numbers[0] for n in numbers], float)  # large numbers lose no digit
    if options.stamp is not None:
        return float(numbers[0] * UNITS[options.stamp]) + away * UNITS[options.stamp]
    if options.fps is None:
        raise FileError(folder, "pictures have no times", valid="--fps, or --stamp")
    return away / options.fps


def _rgb(picture: Array, path: Path, options: PictureOptions) -> UInt8[Array, "H W 3"]:
    """8-bit RGB of what OpenCV decoded: grey, BGR or BGRA, or a mosaic."""
    import cv2

    if picture.dtype == np.uint16:
        picture = np.minimum(picture >> max(options.bits - 8, 0), 255).astype(np.uint8)
    if picture.dtype != np.uint8:
        raise FileError(path, f"holds {picture.dtype}", valid="8 or 16 bits a value")
    if options.bayer is not None:
        if picture.ndim != 2:
            raise FileError(path, "is not a raw mosaic", valid="one value a pixel, or no --bayer")
        return cv2.cvtColor(picture, _mosaic(options.bayer))  # pyright: ignore[reportReturnType]
    if picture.ndim == 2:
        return cv2.cvtColor(picture, cv2.COLOR_GRAY2RGB)  # pyright: ignore[reportReturnType]
    return np.ascontiguousarray(picture[..., 2::-1])


def _mosaic(pattern: Bayer) -> int:
    """OpenCV names a mosaic by the second row's second and third pixels, and RGB as BGR."""
    import cv2

    return {"RGGB": cv2.COLOR_BayerRGGB2RGB, "BGGR": cv2.COLOR_BayerBGGR2RGB,
            "GRBG": cv2.COLOR_BayerGRBG2RGB, "GBRG": cv2.COLOR_BayerGBRG2RGB}[pattern]  # fmt: skip
