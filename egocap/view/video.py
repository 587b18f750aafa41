"""Video files, written frame by frame."""

from __future__ import annotations

from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from egocap.errors import InputError
from egocap.files import make_folder, replacing

_QUALITY = {"preset": "superfast", "crf": "23", "movflags": "+faststart"}


class VideoFile:
    """An H.264 file in MPEG-4, put in place when it is closed without an error.

    Raises InputError for another suffix, and as `egocap.files.disk_errors`.
    """

    def __init__(self, out: Path, fps: float = 30.0) -> None:
        if out.suffix.lower() != ".mp4":
            raise InputError(f"cannot write '{out.name}'", valid="a name that ends in .mp4")
        if out.is_dir():
            raise InputError(f"{out} is a folder", valid="the name of a file")
        self.out, self.fps, self.frames = out, fps, 0
        self._open = ExitStack()
        self._container: Any = None
        self._stream: Any = None

    def __enter__(self) -> VideoFile:
        return self

    def __exit__(self, kind: Any, *exception: Any) -> None:
        if self._stream is not None and kind is None:
            self._container.mux(self._stream.encode(None))
        self._open.__exit__(kind, *exception)

    def add(self, picture: UInt8[Array, "H W 3"], at: float | None = None) -> None:
        """Add an RGB picture; all have the size of the first, with even sides.

        `at` is its time from the start [s]: the picture is dropped or repeated to be shown at the
        nearest frame's.
        Without it every picture is one frame.
        """
        import cv2
        from av.video.frame import VideoFrame

        if self._stream is None:
            self._stream = self._begin(picture.shape[1], picture.shape[0])
        wanted = self.frames + 1 if at is None else int(at * self.fps + 0.5) + 1
        while self.frames < wanted:
            # OpenCV converts faster than the encoder's own scaler, by the same matrix (BT.601).
            planes = np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2YUV_I420), np.uint8)
            frame = VideoFrame.from_ndarray(planes, format="yuv420p")
            frame.pts = self.frames
            self._container.mux(self._stream.encode(frame))
            self.frames += 1

    def _begin(self, width: int, height: int) -> Any:
        import av.container

        make_folder(self.out.parent)
        part = self._open.enter_context(replacing(self.out, keep_suffix=True))
        self._container = self._open.enter_context(av.open(str(part), "w"))
        rate = Fraction(self.fps).limit_denominator(1001)
        stream = self._container.add_stream("libx264", rate, options=_QUALITY)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        return stream
