"""Video files, written frame by frame."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Any

from jaxtyping import UInt8
from numpy import ndarray as Array

from egocap.errors import InputError, MachineError
from egocap.files import make_folder, replacing


class VideoFile:
    """An MPEG-4 file, put in place when it is closed without an error.

    Raises InputError for another suffix, MachineError if the video cannot be written.
    """

    def __init__(self, out: Path, fps: float = 30.0) -> None:
        if out.suffix.lower() != ".mp4":
            raise InputError(f"cannot write '{out.name}'", valid="a name that ends in .mp4")
        if out.is_dir():
            raise InputError(f"{out} is a folder", valid="the name of a file")
        self.out, self.fps, self.frames = out, fps, 0
        self._open = ExitStack()
        self._writer = None

    def __enter__(self) -> VideoFile:
        return self

    def __exit__(self, *exception: Any) -> None:
        if self._writer is not None:
            self._writer.release()
        self._open.__exit__(*exception)

    def add(self, picture: UInt8[Array, "H W 3"], at: float | None = None) -> None:
        """Add an RGB picture; all have the size of the first, with even sides.

        `at` is its time from the start [s]: the picture is dropped or repeated to keep that time.
        Without it every picture is one frame.
        """
        import cv2

        if self._writer is None:
            make_folder(self.out.parent)
            part = self._open.enter_context(replacing(self.out, keep_suffix=True))
            size = picture.shape[1], picture.shape[0]
            fourcc = cv2.VideoWriter.fourcc(*"mp4v")
            self._writer = cv2.VideoWriter(str(part), fourcc, self.fps, size)
            if not self._writer.isOpened():
                raise MachineError(f"OpenCV cannot write {self.out}",
                                   remedy="is the folder writable?")  # fmt: skip
        wanted = self.frames + 1 if at is None else int(at * self.fps + 1e-6) + 1
        while self.frames < wanted:
            self._writer.write(picture[..., ::-1])
            self.frames += 1
