"""Detection of a long recording in pieces, so that an interrupted run goes on where it stopped."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from pathlib import Path

from egocap.data.detections import Detections, load_detections, save_detections
from egocap.data.sequence import Sequence
from egocap.detect.detector import Detector, joined
from egocap.detect.view_times import at_frame_times
from egocap.errors import FileError
from egocap.files import make_folder

PIECE = 600  # frames


def detect_in_pieces(
    sequence: Sequence,
    detector: Detector,
    folder: Path,
    on_frames: Callable[[int], None] = lambda count: None,
) -> Detections:
    """Detections in all frames. Pieces are kept in `folder` until the caller removes it."""
    make_folder(folder)
    frames = len(sequence)
    for number in count():
        rows = range(number * PIECE, min((number + 1) * PIECE, frames))
        if not rows:
            break
        path = folder / f"{number:05d}.npz"
        if not _there(path, len(rows)):
            save_detections(path, detector.detect_rows(sequence, rows, on_frames=on_frames))
        else:
            on_frames(len(rows))
    found = joined([load_detections(path) for path in sorted(folder.glob("?????.npz"))])
    if sequence.frame_times is None:
        return found
    return at_frame_times(found, sequence.frame_times, sequence.rig)


def _there(path: Path, frames: int) -> bool:
    try:
        return len(load_detections(path).times) == frames
    except FileError:
        return False
