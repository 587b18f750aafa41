"""Memory of motion capture against the length of the footage.

A short simulated sequence is played forwards and backwards into long videos of small pictures,
which `egocap mocap` captures in processes of their own. The growth of the peaks gives what a
long recording takes.
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

from egocap.errors import InputError
from egocap.evaluation.table import Table, number
from egocap_eval.footage.process import run_egocap
from egocap_eval.harness.footage import builtin_scene, prepare_sequence
from egocap_eval.harness.study import Outcome
from egocap_eval.studies.fit_body import person_height
from egocap_sim.scene.config import RecordTable

LONG_FRAMES = 54_000  # 30 minutes at 30 Hz
TARGET_MB = 2048.0
_HZ = 30


def study(
    frames: tuple[int, ...] = (2000, 10000),
    size: tuple[int, int] = (160, 128),
    unique: int = 150,
    work: Annotated[Path, arg(metavar="DIR")] = Path("out/capture-memory"),
) -> Outcome:
    """Capture ever longer footage; measure the peak memory of all processes together.

    Args:
        frames: Lengths of the footage, frames.
        size: Image width and height; decoded pictures are a small part of the memory.
        unique: Frames of the sequence, which is played forwards and backwards.
        work: Folder of the sequence, the videos and captures; one of them at a time is kept.
    """
    if len(frames) < 2 or min(frames) < 2:
        raise InputError(f"--frames {' '.join(map(str, frames))}", valid="two lengths or more")
    scene = builtin_scene("validation-walk", size, frames=unique, record=RecordTable(masks=False))
    sequence = prepare_sequence(scene, work / "sequence")
    height = str(round(person_height(sequence.folder), 2))
    rows = []
    for count in frames:
        folder = work / str(count)
        if folder.exists():
            shutil.rmtree(folder)
        folder.mkdir(parents=True)
        films = [folder / f"{view}.mp4" for view in sequence.rig.views]
        for v, film in enumerate(films):
            write_loop(film, [frame.images[v] for frame in sequence], count)
        rig, out = sequence.folder / "rig.json", folder / "capture"
        spent = run_egocap(["mocap", *map(str, films), "--rig", str(rig), "--out", str(out),
                            "--height", height, "--lag", "0"])  # fmt: skip
        shutil.rmtree(folder)
        rows.append({"frames": count, "peak_mb": spent.peak_mb,
                     "cpu_ms_per_frame": 1e3 * spent.cpu_s / count})  # fmt: skip
    lengths, peaks = (np.array([row[k] for row in rows]) for k in ("frames", "peak_mb"))
    growth = max(float(np.polyfit(lengths, peaks, 1)[0]), 0.0)  # processes' own size varies
    long_mb = float(peaks.max() + growth * max(LONG_FRAMES - lengths.max(), 0))
    result: dict[str, Any] = {"size": list(size), "rows": rows,
                              "mb_per_1000_frames": 1e3 * growth,
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


def _table(result: dict[str, Any]) -> Table:
    rows = tuple((str(row["frames"]), number(row["peak_mb"], 0),
                  number(row["cpu_ms_per_frame"], 0)) for row in result["rows"])  # fmt: skip
    ahead = (f"{LONG_FRAMES} (30 minutes), extrapolated", number(result["mb_of_30_minutes"], 0), "")
    return Table("Peak memory of motion capture", ("frames", "MB", "CPU ms a frame"),
                 (*rows, ahead))  # fmt: skip
