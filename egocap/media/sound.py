"""Sound tracks of video files: loudness over the file's own time."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.errors import FileError

RATE = 16_000  # Hz
HOP = 32  # samples of one value: 2 ms


def loudness(path: str | Path) -> tuple[Float[Array, "N"], Float[Array, "N"]] | None:
    """Times [s] by the file's clock and root-mean-square amplitude of every 2 ms of its sound.

    None for a file without sound. What cannot be decoded is silent. Raises FileError.
    """
    import av
    import av.error

    path = Path(path)
    powers = _Powers()
    try:
        with av.open(str(path), metadata_errors="replace") as container:
            if not container.streams.audio:
                return None
            stream = container.streams.audio[0]
            resampler = av.AudioResampler(format="flt", layout="mono", rate=RATE)
            for packet in container.demux(stream):
                _add(powers, packet, resampler)
    except (av.error.FFmpegError, OSError) as error:
        if powers.first is None:
            raise FileError(path, f"its sound cannot be read: {error.strerror or error}") from None
    return None if powers.first is None else powers.amplitudes(powers.first)


class _Powers:
    """Sums of squared samples by even steps of time, whatever the blocks' lengths and gaps."""

    def __init__(self) -> None:
        self.first: float | None = None  # s
        self._sums: list[tuple[int, Float[Array, "n"]]] = []  # of every block, from which hop on

    def add(self, start: float, samples: Float[Array, "n"]) -> None:
        self.first = start if self.first is None else self.first
        hops = (round((start - self.first) * RATE) + np.arange(len(samples))) // HOP
        if len(hops) and hops[0] >= 0:
            self._sums.append((int(hops[0]), np.bincount(hops - hops[0], samples**2)))

    def amplitudes(self, first: float) -> tuple[Float[Array, "N"], Float[Array, "N"]]:
        total = np.zeros(max(at + len(sums) for at, sums in self._sums))
        for at, sums in self._sums:
            total[at : at + len(sums)] += sums
        times = first + (np.arange(len(total) - 1) + 0.5) * HOP / RATE
        return times, np.sqrt(total[:-1] / HOP)  # the last step is not full


def _add(powers: _Powers, packet: Any, resampler: Any) -> None:
    """Add the sound of a packet; what cannot be decoded is left out."""
    import av.error

    with suppress(av.error.FFmpegError):
        for frame in packet.decode():
            if frame.pts is not None:
                for block in resampler.resample(frame):
                    powers.add(float(block.pts * block.time_base), block.to_ndarray()[0])
