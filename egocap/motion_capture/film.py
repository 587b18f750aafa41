"""The film of a run: all views with the skeleton over them, and the pose from outside."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from egocap.data.sequence import Sequence
from egocap.data.track import Track
from egocap.detect.input_images import ahead
from egocap.view.skeleton import side_by_side
from egocap.view.video import VideoFile


def write_film(
    path: Path,
    sequence: Sequence,
    track: Track,
    on_frames: Callable[[int], None] = lambda count: None,
) -> None:
    """Write the film, as long as the footage. A thread decodes ahead of the drawing."""
    start = float(track.times[0])
    with VideoFile(path, sequence.manifest.fps) as film:
        for index, images in ahead(iter(range(len(sequence))), lambda i: (i, sequence.pictures(i))):
            film.add(picture(sequence, track, index, images), float(track.times[index]) - start)
            on_frames(1)


def picture(sequence: Sequence, track: Track, index: int, images=None):
    """One picture of the film, RGB."""
    assert track.confidence is not None
    seen = sequence.pictures(index) if images is None else images
    return side_by_side(seen, track.joints_head[index], track.confidence[index], sequence.rig)
