"""Memory of motion capture against the length of the footage.

A short pair of videos is played forwards and backwards into long ones of small pictures, which
`egocap mocap` captures in processes of their own. A line through the peaks gives what a long
recording takes.
"""

from __future__ import annotations

import shutil
from fractions import Fraction
from itertools import cycle, islice
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array
from tyro.conf import arg

from egocap.cameras.rig_files import load_rig
from egocap.errors import InputError
from egocap.evaluation.table import Table, number
from egocap.media.source import open_source
from egocap_eval.footage.process import run_egocap
from egocap_eval.harness.study import Outcome

LONG_FRAMES = 54_000  # 30 minutes at 30 Hz
TARGET_MB = 2048.0
_HZ = 30


def study(
    videos: Annotated[Path, arg(metavar="DIR")],
    frames: tuple[int, ...] = (2000, 10000),
    size: tuple[int, int] = (160, 128),
    height: float = 1.75,
    unique: int = 150,
    work: Annotated[Path, arg(metavar="DIR")] = Path("out/capture-memory"),
) -> Outcome:
    """Capture ever longer footage; measure the peak memory of all processes together.

    Args:
        videos: Folder of an export: VIEW.mp4 of every view, rig.json.
        frames: Lengths of the footage, frames.
        size: Image width and height; decoded pictures are a small part of the memory.
        height: Height of the person in metres.
        unique: Frames of the videos that are played forwards and backwards.
        work: Folder of long videos and captures; one at a time is kept.
    """
    if len(frames) < 2 or min(frames) < 2:
        raise InputError(f"--frames {' '.join(map(str, frames))}", valid="two lengths or more")
    rig = load_rig(videos / "rig.json")
    short = [_pictures(videos / f"{view}.mp4", unique, size) for view in rig.views]
    rows = []
    for count in frames:
        folder = work / str(count)
        if folder.exists():
            shutil.rmtree(folder)
        folder.mkdir(parents=True)
        for view, pictures in zip(rig.views, short, strict=True):
            write_loop(folder / f"{view}.mp4", pictures, count)
        spent = run_egocap(["mocap", *(str(folder / f"{view}.mp4") for view in rig.views), "--rig",
                            str(videos / "rig.json"), "--height", str(height), "--lag", "0",
                            "--out", str(folder / "capture")])  # fmt: skip
        shutil.rmtree(folder)
        rows.append({"frames": count, "peak_mb": spent.peak_mb,
                     "cpu_ms_per_frame": 1e3 * spent.cpu_s / count})  # fmt: skip
    slope, start = np.polyfit([row["frames"] for row in rows], [row["peak_mb"] for row in rows], 1)
    long_mb = float(start + slope * LONG_FRAMES)
    result: dict[str, Any] = {"size": list(size), "rows": rows,
                              "mb_per_1000_frames": float(1e3 * slope),
                              "mb_of_30_minutes": long_mb}  # fmt: skip
    missed = [f"{long_mb:.0f} MB for 30 minutes (target {TARGET_MB:g})"] * (long_mb > TARGET_MB)
    return Outcome(result, [_table(result)], missed)


def write_loop(path: Path, pictures: list[UInt8[Array, "h w 3"]], count: int) -> None:
    """A video of so many frames, of the pictures forwards and backwards."""
    import av

    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("libx264", rate=_HZ, options={"preset": "ultrafast"})
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        for i, picture in enumerate(islice(cycle([*pictures, *pictures[-2:0:-1]]), count)):
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts, frame.time_base = i, Fraction(1, _HZ)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def _pictures(path: Path, count: int, size: tuple[int, int]) -> list[UInt8[Array, "h w 3"]]:
    import cv2

    found = islice(open_source(path).frames(), count)
    return [np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
            for _, image in found]  # fmt: skip


def _table(result: dict[str, Any]) -> Table:
    rows = tuple((str(row["frames"]), number(row["peak_mb"], 0),
                  number(row["cpu_ms_per_frame"], 0)) for row in result["rows"])  # fmt: skip
    ahead = (f"{LONG_FRAMES} (30 minutes), extrapolated", number(result["mb_of_30_minutes"], 0), "")
    return Table("Peak memory of motion capture", ("frames", "MB", "CPU ms a frame"),
                 (*rows, ahead))  # fmt: skip
