"""Sound tracks of video files: their samples, and their loudness over the file's own time."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int16
from numpy import ndarray as Array

from egocap.errors import FileError

RATE = 16_000  # Hz
HOP = 32  # samples of one value of the loudness: 2 ms
_JITTER_S = 5e-3  # by which the times that a container states for its blocks are rounded


@dataclass(frozen=True, eq=False)
class Soundtrack:
    """Samples of one microphone at `RATE`, the first at `start` by the file's clock [s]."""

    start: float
    samples: Int16[Array, "N"]

    def loudness(self) -> tuple[Float[Array, "M"], Float[Array, "M"]]:
        """Times [s] and root-mean-square amplitude, at most 1, of every 2 ms."""
        blocks = self.samples[: len(self.samples) // HOP * HOP].reshape(-1, HOP)
        power = np.einsum("nk,nk->n", blocks, blocks, dtype=np.float32)
        times = self.start + (np.arange(len(blocks)) + 0.5) * HOP / RATE
        return times, np.sqrt(power / HOP) / 32767.0


def read_sound(path: str | Path) -> Soundtrack | None:
    """The sound track of a file, all channels together; None for a file without sound.

    What cannot be decoded is silent. Raises FileError.
    """
    import av
    import av.error

    path = Path(path)
    blocks = _Blocks()
    try:
        with av.open(str(path), metadata_errors="replace") as container:
            if not container.streams.audio:
                return None
            stream = container.streams.audio[0]
            resampler = av.AudioResampler(format="s16", layout="mono", rate=RATE)
            for packet in container.demux(stream):
                _add(blocks, packet, resampler)
    except (av.error.FFmpegError, OSError) as error:
        if blocks.first is None:
            raise FileError(path, f"its sound cannot be read: {error.strerror or error}") from None
    return None if blocks.first is None else Soundtrack(blocks.first, blocks.joined())


class _Blocks:
    """Blocks of samples, one after the other, with silence where the file has a gap."""

    def __init__(self) -> None:
        self.first: float | None = None  # s
        self._placed: list[tuple[int, Int16[Array, "n"]]] = []  # from which sample on
        self._end = 0

    def add(self, start: float, samples: Int16[Array, "n"]) -> None:
        self.first = start if self.first is None else self.first
        at = round((start - self.first) * RATE)
        at = self._end if abs(at - self._end) < _JITTER_S * RATE else at
        if at >= 0:
            self._placed.append((at, samples))
            self._end = at + len(samples)

    def joined(self) -> Int16[Array, "N"]:
        whole = np.zeros(max(at + len(block) for at, block in self._placed), np.int16)
        for at, block in self._placed:
            whole[at : at + len(block)] = block
        return whole


def _add(blocks: _Blocks, packet: Any, resampler: Any) -> None:
    """Add the sound of a packet; what cannot be decoded is left out."""
    import av.error

    with suppress(av.error.FFmpegError):
        for frame in packet.decode():
            if frame.pts is not None:
                for block in resampler.resample(frame):
                    blocks.add(float(block.pts * block.time_base), block.to_ndarray()[0])
