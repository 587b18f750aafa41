"""A source of pictures: a video file or a folder of picture files, opened by its path."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, Protocol

from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.errors import FileError
from egocap.media.pictures import PictureOptions, open_pictures
from egocap.media.video import open_video


class PictureSource(Protocol):
    """What a video and a folder of pictures have in common."""

    path: Path
    size: tuple[int, int]  # width and height of a picture, after rotation

    @property
    def times(self) -> Float[Array, "N"]:
        """When each picture was taken, as the source states it [s]; increasing."""
        ...

    def frames(self) -> Iterator[tuple[float, UInt8[Array, "H W 3"]]]:
        """Time and RGB image of every picture that can be decoded, in order."""
        ...

    def image(self, index: int) -> UInt8[Array, "H W 3"] | None:
        """RGB image of one picture, by its place in `times`; None where it is damaged."""
        ...

    def close(self) -> None:
        """Release the file."""
        ...


class Part(NamedTuple):
    """One of several views that share a picture, side by side."""

    place: int = 0  # from the left
    of: int = 1

    def columns(self, width: int) -> slice:
        """Columns of this view in a picture of a width."""
        return slice(width * self.place // self.of, width * (self.place + 1) // self.of)


def open_source(path: str | Path, options: PictureOptions | None = None) -> PictureSource:
    """Open a video file or a folder of pictures. Raises FileError.

    `options` say how the files of a folder are read; videos ignore them.
    """
    path = Path(path)
    if not path.exists():
        raise FileError(path, "no such file", valid="a video, or a folder of pictures")
    return open_pictures(path, options) if path.is_dir() else open_video(path)
