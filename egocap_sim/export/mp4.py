"""Export to a video: the views side by side with the true joints drawn over them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from egocap.data.sequence import Sequence
from egocap.data.truth import OUT_OF_VIEW
from egocap.errors import InputError, MachineError
from egocap.files import make_folder, replacing
from egocap_sim.export.preview import overlay

WIDTH = 640  # pixels of each view, at most


def write_mp4(sequence: Sequence, out: Path, on_frames: Callable[[int], None]) -> None:
    """Write an MPEG-4 video at the sequence's frame rate. Raises InputError for another suffix."""
    if out.suffix.lower() != ".mp4":
        raise InputError(f"cannot write '{out.name}'", valid="a name that ends in .mp4")
    make_folder(out.parent)
    cameras = sequence.rig.cameras
    scale = min(1.0, WIDTH / max(c.width for c in cameras))
    # MPEG-4 requires even sides.
    sizes = [(round(c.width * scale / 2) * 2, round(c.height * scale / 2) * 2) for c in cameras]
    shape = sum(w for w, _ in sizes), max(h for _, h in sizes)
    fourcc = cv2.VideoWriter.fourcc(*"mp4v")
    with replacing(out, keep_suffix=True) as part:
        writer = cv2.VideoWriter(str(part), fourcc, sequence.manifest.fps, shape)
        if not writer.isOpened():
            raise MachineError(f"OpenCV cannot write {out}", remedy="is the folder writable?")
        for frame in sequence:
            writer.write(_picture(sequence, frame.index, frame.images, sizes, shape))
            on_frames(1)
        writer.release()
        written = int(cv2.VideoCapture(str(part)).get(cv2.CAP_PROP_FRAME_COUNT))
        if written != len(sequence):  # OpenCV does not tell
            raise MachineError(f"{out}: {written} of {len(sequence)} frames could be written",
                               remedy="is the disk full?")  # fmt: skip


def _picture(
    sequence: Sequence,
    index: int,
    images: tuple[np.ndarray, ...],
    sizes: list[tuple[int, int]],
    shape: tuple[int, int],
) -> np.ndarray:
    """One picture of the video, BGR."""
    truth = sequence.truth
    picture, left = np.zeros((shape[1], shape[0], 3), np.uint8), 0
    for v, (image, (width, height)) in enumerate(zip(images, sizes, strict=True)):
        visibility = truth.visibility[index, v]
        drawn = overlay(image, truth.joints_2d[index, v], visibility != OUT_OF_VIEW, visibility)
        small = cv2.resize(drawn, (width, height), interpolation=cv2.INTER_AREA)
        picture[:height, left : left + width] = small[..., ::-1]
        left += width
    return picture
