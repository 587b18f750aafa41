"""A film of pictures as they come, written whole or not at all."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType

from jaxtyping import UInt8
from numpy import ndarray as Array

from egocap.errors import InputError, MachineError


class VideoFile:
    """An MPEG-4 file that grows frame by frame and gets its name when it is closed without error.

    Raises InputError for another suffix, MachineError where no film can be written.
    """

    def __init__(self, out: Path, fps: float = 30.0) -> None:
        if out.suffix.lower() != ".mp4":
            raise InputError(f"cannot write '{out.name}'", valid="a name that ends in .mp4")
        if out.is_dir():
            raise InputError(f"{out} is a folder", valid="the name of a file")
        self.out, self.fps, self.frames = out, fps, 0
        self._part = out.with_name(f".{out.stem}.part.mp4")
        self._writer = None

    def __enter__(self) -> VideoFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:  # fmt: skip
        if self._writer is not None:
            self._writer.release()
            if kind is None:
                self._part.replace(self.out)
            self._part.unlink(missing_ok=True)

    def add(self, picture: UInt8[Array, "H W 3"], at: float | None = None) -> None:
        """Add an RGB picture; all have the size of the first, with even sides.

        `at` is its time from the beginning, s: it is left out or repeated so that the film keeps
        that time. Without it every picture is one frame.
        """
        import cv2

        if self._writer is None:
            self.out.parent.mkdir(parents=True, exist_ok=True)
            size = picture.shape[1], picture.shape[0]
            fourcc = cv2.VideoWriter.fourcc(*"mp4v")
            self._writer = cv2.VideoWriter(str(self._part), fourcc, self.fps, size)
            if not self._writer.isOpened():
                raise MachineError(f"OpenCV cannot write {self.out}",
                                   remedy="is the folder writable?")  # fmt: skip
        wanted = self.frames + 1 if at is None else int(at * self.fps + 1e-6) + 1
        while self.frames < wanted:
            self._writer.write(picture[..., ::-1])
            self.frames += 1
