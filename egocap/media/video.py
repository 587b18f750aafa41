"""Video files: every decodable frame with the time that its container states.

Times are presentation times, so that variable frame rates, dropped frames and B-frames are as
recorded. Rotation flags are applied. Frames that the decoder cannot restore are left out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cached_property
from heapq import heappop, heappush
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.errors import FileError

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.packet import Packet
    from av.video.frame import VideoFrame
    from av.video.stream import VideoStream

_READ_ON_S = 1.0
"""Seconds ahead up to which `Video.image` decodes on instead of seeking."""
_BACK_S = 0.1  # by which times of decoding may fall: as in ffmpeg
_WRAPPED_S = 12 * 3600.0  # a larger step is a jump back, taken for the end of a 33-bit counter
_TICK_S = 1e-6  # by which times may differ in rounding


class Video:
    """A video file, open for reading. Not to be shared between threads.

    Raises FileError if it is no video, or holds no frame that can be decoded.
    """

    def __init__(self, path: str | Path) -> None:
        from av.video.reformatter import VideoReformatter

        self.path = Path(path)
        self._to_rgb = VideoReformatter()  # one a frame would begin its threads again and again
        first = next(self.frames(), None)
        if first is None:
            raise FileError(self.path, "holds no frame that can be decoded", valid="a whole video")
        height, width = first[1].shape[:2]
        self.size = (width, height)
        self._run: Iterator[tuple[float, VideoFrame]] = iter(())
        self._last: tuple[float, VideoFrame | None] = (math.inf, None)

    def __repr__(self) -> str:
        return f"Video('{self.path}', {self.size[0]} x {self.size[1]}, {len(self.times)} frames)"

    @property
    def times(self) -> Float[Array, "N"]:
        """Time of every frame in the file, damaged ones included [s]; increasing.

        The whole file is read once, and nothing decoded. Raises FileError where the clock jumps
        back, as in files that were joined byte by byte: pictures would share their times.
        """
        return self._times

    @cached_property
    def _times(self) -> Float[Array, "N"]:
        with self._open() as (container, stream):
            packets = [
                (_stamp(packet.pts, packet.dts), packet.dts)
                for packet in _packets(container, stream)
                if not packet.is_discard
            ]
            assert stream.time_base is not None
            base = float(stream.time_base)
        self._require_one_clock(np.array([base * dts for _, dts in packets if dts is not None]))
        return np.sort([stamp * base for stamp in {stamp for stamp, _ in packets}
                        if stamp is not None])  # fmt: skip

    def _require_one_clock(self, decoding: Float[Array, "n"]) -> None:
        """Raise FileError where times of decoding, in the file's order, are of several clocks."""
        from scipy.ndimage import median_filter

        decoding = median_filter(decoding, 5, mode="nearest")  # but for single damaged ones
        steps = np.diff(decoding)
        jump = np.flatnonzero((steps < -_BACK_S) | (steps > _WRAPPED_S))
        if len(jump):
            before, after = decoding[jump[0] : jump[0] + 2]
            raise FileError(self.path, f"its clock jumps from {before:.2f} to {after:.2f} s",
                            valid="one recording a file; ffmpeg -i FILE -c copy NEW.mp4 makes the "
                            "times even")  # fmt: skip

    def frames(self) -> Iterator[tuple[float, UInt8[Array, "H W 3"]]]:
        """Time [s] and RGB image of every decodable frame, in order."""
        return ((time, self._upright(frame)) for time, frame in self._from(-math.inf))

    def _from(self, start: float) -> Iterator[tuple[float, VideoFrame]]:
        """Frames from a time or before on: seeking may end behind the key frame that is needed."""
        back = 0.0
        while True:
            with self._open() as (container, stream):
                seeks = start > back and math.isfinite(start) and _seekable(container, stream)
                if seeks:
                    assert stream.time_base is not None
                    container.seek(int((start - back) / stream.time_base), stream=stream)
                frames = self._timed(container, stream)
                first = next(frames, None)
                if not seeks or (first is not None and first[0] <= start + _TICK_S):
                    yield from frames if first is None else chain([first], frames)
                    return
            back = max(2.0 * back, 1.0)

    def _timed(
        self, container: InputContainer, stream: VideoStream
    ) -> Iterator[tuple[float, VideoFrame]]:
        """Frames with their times. Raises FileError for a file that states none."""
        for stamp, frame in _decoded(container, stream):
            if stamp is None:
                raise FileError(self.path, "does not state the times of its pictures",
                                valid="mp4, mkv, avi or mov")  # fmt: skip
            assert stream.time_base is not None
            yield float(stamp * stream.time_base), frame

    def image(self, index: int) -> UInt8[Array, "H W 3"] | None:
        """RGB image of a frame, by its place in `times`; None where it is damaged.

        Fast in order; a jump decodes from the nearest key frame before.
        """
        wanted = float(self.times[index])
        if not self._last[0] - _TICK_S <= wanted <= self._last[0] + _READ_ON_S:
            self._run = self._from(wanted)
            self._last = (-math.inf, None)
        while self._last[0] < wanted - _TICK_S:
            self._last = next(self._run, (math.inf, None))
        time, frame = self._last
        return None if frame is None or time > wanted + _TICK_S else self._upright(frame)

    def _upright(self, frame: VideoFrame) -> UInt8[Array, "H W 3"]:
        """The RGB image, turned counterclockwise as the file's display matrix says."""
        image = self._to_rgb.reformat(frame, format="rgb24").to_ndarray()
        quarters = round(frame.rotation / 90) % 4
        return np.ascontiguousarray(np.rot90(image, quarters)) if quarters else image

    def close(self) -> None:
        """Release the file."""
        self._run, self._last = iter(()), (math.inf, None)

    def _open(self) -> _Opened:
        return _Opened(self.path)


class _Opened:
    """The container and its first video stream, closed at the end of a `with`."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __enter__(self) -> tuple[InputContainer, VideoStream]:
        import av.container
        import av.error

        try:
            self.container = av.open(str(self.path), metadata_errors="replace")
        except (av.error.FFmpegError, OSError) as error:
            raise FileError(
                self.path, f"cannot be read as a video: {error.strerror or error}",
                valid="mp4, mkv, avi or mov, complete",
            ) from None  # fmt: skip
        if not self.container.streams.video:
            self.container.close()
            raise FileError(self.path, "holds no pictures", valid="a video")
        stream = self.container.streams.video[0]
        stream.thread_type = "AUTO"
        stream.codec_context.thread_count = 0  # as many as there are cores
        return self.container, stream

    def __exit__(self, *_: object) -> None:
        self.container.close()


def open_video(path: str | Path) -> Video:
    """Open a video file. Raises FileError."""
    return Video(path)


def _packets(container: InputContainer, stream: VideoStream) -> Iterator[Packet]:
    """Packets up to the end, or to where the file breaks off."""
    import av.error

    try:
        for packet in container.demux(stream):
            if packet.size:  # the last one is empty: `_decoded` asks for what is left itself
                yield packet
    except av.error.FFmpegError:
        return


def _decoded(
    container: InputContainer, stream: VideoStream
) -> Iterator[tuple[int | None, VideoFrame]]:
    """Frames with their stamps, without those that the decoder knows to be damaged."""
    import av.error

    sent: list[int] = []  # stamps of pictures that the decoder still holds
    reordered = _reordered(container, stream)
    for packet in chain(_packets(container, stream), [None]):
        if packet is not None and reordered:
            heappush(sent, _stamp(packet.pts, packet.dts) or 0)
        try:
            frames = stream.decode(packet)
        except av.error.FFmpegError:
            continue
        for frame in frames:
            stamp = heappop(sent) if sent else _stamp(frame.pts, frame.dts)
            if not frame.is_corrupt:
                yield stamp, frame


def _reordered(container: InputContainer, stream: VideoStream) -> bool:
    """Whether stamps are in decoding's order, not in that of the pictures: B-frames in AVI."""
    return container.format.name == "avi" and bool(stream.codec_context.has_b_frames)


def _seekable(container: InputContainer, stream: VideoStream) -> bool:
    """Whether pictures have the same times after a jump. Program streams state those of few."""
    return container.format.name != "mpeg" and not _reordered(container, stream)


def _stamp(pts: int | None, dts: int | None) -> int | None:
    """An AVI file states decoding times only."""
    return dts if pts is None else pts
