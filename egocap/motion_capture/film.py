"""The film of a run: all views with the skeleton over them, and the pose from outside."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from jaxtyping import UInt8
from numpy import ndarray as Array

from egocap.data.sequence import Sequence
from egocap.data.track import Track
from egocap.detect.input_images import ahead
from egocap.view.skeleton import side_by_side
from egocap.view.video import VideoFile

FILM_HZ = 15.0


def write_film(
    path: Path,
    sequence: Sequence,
    track: Track,
    on_frames: Callable[[int], None] = lambda count: None,
) -> None:
    """Write the film, as long as the footage, at a rate of `FILM_HZ` or little more.

    A thread decodes and draws ahead of the encoder.
    """
    step = max(1, int(sequence.manifest.fps / FILM_HZ + 0.05))
    rows = range(0, len(sequence), step)
    drawn = ahead(iter(rows), lambda index: picture(sequence, track, index))
    with VideoFile(path, sequence.manifest.fps / step) as film:
        for index, image in zip(rows, drawn, strict=True):
            film.add(image, float(track.times[index] - track.times[0]))
            on_frames(min(step, len(sequence) - index))


def picture(sequence: Sequence, track: Track, index: int) -> UInt8[Array, "h w 3"]:
    """One picture of the film, RGB."""
    assert track.confidence is not None
    images, rig = sequence.pictures(index), sequence.rig
    return side_by_side(images, track.joints_head[index], track.confidence[index], rig)
