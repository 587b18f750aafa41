"""One pass over the pictures of a source: which can be decoded, how each differs from the last.

The result is kept as npz, so that an interrupted import does not decode twice.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import repeat

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from egocap.cameras.rig import Mount, Rig
from egocap.data.arrays import FrameArrays
from egocap.data.resampling import typical_step
from egocap.footage.head_rotation import RotationMeter
from egocap.footage.photometry import SIZE, median_colour, shared_surroundings
from egocap.media.source import Part, PictureSource

_SIZE = (80, 64)  # to which pictures are reduced, px
_TICK_S = 1e-5  # by which the time of a picture and of its place in the file may differ


@dataclass(frozen=True, eq=False)
class ViewScan(FrameArrays):
    """What is known of every picture of one view. Axis N: pictures in the order of their times."""

    time: Float[Array, "N"]  # s, as the file states it
    decoded: Bool[Array, "N"]
    change: Float[Array, "N"]  # mean absolute difference to the last decoded picture, grey levels
    light: Float[Array, "N"]  # mean grey level
    turn: Float[Array, "N 3"]  # rotation of the rig since the last decoded picture [rad]
    colour: Float[Array, "N 3"]  # median red, green, blue of the surroundings; nan: not known

    @property
    def period(self) -> float:
        """Time between pictures [s]."""
        return typical_step(self.time) if len(self.time) > 1 else 1.0 / 30.0

    @property
    def dropped(self) -> int:
        """Number of pictures that the gaps between times have room for."""
        return int(np.maximum(np.rint(np.diff(self.time) / self.period) - 1.0, 0.0).sum())


class PictureMeter:
    """Measures the rotation of the rig and the colours of the surroundings in a view's pictures."""

    def __init__(self, mount: Mount, surroundings: Bool[Array, "64 80"]) -> None:
        self._rotation, self._surroundings = RotationMeter(mount), surroundings

    def add(self, image: UInt8[Array, "H W 3"]) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
        """Rotation since the picture before [rad] and median colour of the next picture."""
        import cv2

        small = cv2.resize(image, SIZE, interpolation=cv2.INTER_AREA)
        return self._rotation.add(image), median_colour(small, self._surroundings)


def picture_meters(rig: Rig) -> dict[str, PictureMeter]:
    """A meter for every view by its name."""
    masks = shared_surroundings(rig)
    return {m.name: PictureMeter(m, mask) for m, mask in zip(rig.mounts, masks, strict=True)}


def scan(
    source: PictureSource,
    parts: tuple[Part, ...],
    meters: Sequence[PictureMeter],
    on_frames: Callable[[int], None] = lambda count: None,
) -> list[ViewScan]:
    """Scan the views that share a source, each with its meter.

    `on_frames` is called for every picture read.
    """
    times = source.times
    N = len(times)
    decoded, change, light = np.zeros(N, bool), np.zeros((len(parts), N)), np.zeros((len(parts), N))
    turn, colour = np.zeros((len(parts), N, 3)), np.full((len(parts), N, 3), np.nan)
    last: list[Array | None] = list(repeat(None, len(parts)))
    at = -1
    for time, image in source.frames():
        i = int(np.searchsorted(times, time - _TICK_S))
        if i >= N or abs(times[i] - time) > 1e-3:
            continue  # the decoder made up a time of its own
        decoded[i] = True
        for p, part in enumerate(parts):
            view = image[:, part.columns(image.shape[1])]
            small = _reduced(view)
            turn[p, i], colour[p, i] = meters[p].add(view)
            light[p, i] = small.mean()
            before = last[p]
            change[p, i] = np.inf if before is None else np.abs(small - before).mean()
            last[p] = small
        on_frames(i - at)
        at = i
    on_frames(N - 1 - at)
    return [
        ViewScan(times, decoded, change[p], light[p], turn[p], colour[p]) for p in range(len(parts))
    ]


def _reduced(image: UInt8[Array, "H W 3"]) -> Float[Array, "h w"]:
    """Every few pixels, so that a difference anywhere is not averaged away."""
    import cv2

    small = cv2.resize(image, _SIZE, interpolation=cv2.INTER_NEAREST)
    return cv2.cvtColor(small, cv2.COLOR_RGB2GRAY).astype(float)
