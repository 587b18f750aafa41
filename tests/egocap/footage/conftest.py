"""Small videos of two views of a moving pattern, with known times."""

from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from egocap.cameras.rig_files import load_rig

SIZE = (64, 48)
CLOCK = 90_000


def scene(time: float, view: int = 0) -> np.ndarray:
    """What a view shows at a time [s]: a pattern that moves, another in each view."""
    x, y = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    grey = 128 + 60 * np.sin(0.4 * x + 9.0 * time + view) + 40 * np.sin(0.3 * y - 7.0 * time)
    return (grey[..., None] * [1.0, 0.9, 0.8]).astype(np.uint8)


def film(path: Path, times, view: int = 0, shown=None) -> Path:
    """A video with a frame at each time, of what the scene shows then, or at the times `shown`."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30, options={"crf": "18"})
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        stream.codec_context.time_base = Fraction(1, CLOCK)
        for time, seen in zip(times, times if shown is None else shown, strict=True):
            picture = np.zeros((*SIZE[::-1], 3), np.uint8) if seen is None else scene(seen, view)
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts, frame.time_base = round(time * CLOCK), Fraction(1, CLOCK)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def pictures(folder: Path, times, view: int = 0) -> Path:
    """A folder of numbered pictures of the scene."""
    folder.mkdir()
    for number, time in enumerate(times):
        cv2.imwrite(str(folder / f"{number:04d}.png"), scene(time, view)[..., ::-1])
    return folder


@pytest.fixture
def rig(request):
    """Two cameras of the size of the videos."""
    return load_rig(request.config.rootpath / "scenes/rigs/egorig1.toml").resized(*SIZE)
