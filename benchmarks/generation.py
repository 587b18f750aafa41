"""Measure speed and memory of `egocap-sim generate`: physics, rendering, truth, JPEG and disk.

    python benchmarks/generation.py                          # both sizes, 1 and 2 workers
    python benchmarks/generation.py --frames 2000 --size 1280x1024 --workers 2    # memory over time

The scene is validation-walk without part labels and depth. `fps` is the rate from the start of the
workers to the last file, `steady_fps` the rate after every worker has finished a shard; `memory_mb`
is the resident memory of the largest worker at each finished shard. `benchmarks/rendering.py`
compares rendering alone with stock pyrender. `--out FILE` saves the result with command, machine
and versions.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import shlex
import sys
import tempfile
import time
from pathlib import Path

SIZES = {"1280x1024": (1280, 1024), "640x512": (640, 512)}


def measure(size: tuple[int, int], workers: int, frames: int) -> dict:
    """Generate one sequence into a temporary folder."""
    from egocap_sim.core.resources import builtin_file
    from egocap_sim.record.recorder import generate
    from egocap_sim.scene.config import Scene, load_scene

    content = load_scene(builtin_file("scene", "validation-walk")).model_dump()
    content["frames"], content["rig"]["size"] = frames, size
    content["record"]["masks"] = False
    memory: list[float] = []
    marks: list[tuple[float, int]] = []

    def on_frames(count: int) -> None:
        marks.append((time.perf_counter(), count))
        memory.append(max(map(_resident_mb, multiprocessing.active_children()), default=0.0))

    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        summary = generate(
            Scene.model_validate(content), Path(folder) / "sequence", workers=workers,
            on_frames=on_frames,
        )  # fmt: skip
        wall = time.perf_counter() - start
    assert summary.physics is not None
    return {
        "size": f"{size[0]}x{size[1]}", "workers": workers, "frames": frames,
        "fps": round(summary.frames_per_second, 2),
        "steady_fps": _steady(marks, workers),
        "wall_s": round(wall, 1),
        "physics_ms_per_second": round(summary.physics.ms_per_second, 1),
        "mb_per_frame": round(summary.bytes / frames / 1e6, 2),
        "memory_mb": memory[1:],
    }  # fmt: skip


def _steady(marks: list[tuple[float, int]], workers: int) -> float | None:
    """Frames a second between the first shard of every worker and the last shard of all."""
    done = marks[1:]  # the first mark counts what an earlier run left: nothing
    if len(done) <= 2 * workers:
        return None
    begun, ended = done[workers - 1][0], done[-1][0]
    return round(sum(count for _, count in done[workers:]) / (ended - begun), 2)


def _resident_mb(process: multiprocessing.process.BaseProcess) -> float:
    try:
        pages = int(Path(f"/proc/{process.pid}/statm").read_text().split()[1])
    except OSError:
        return 0.0
    return round(pages * 4096 / 1e6, 1)


def main() -> None:
    """Measure, print one line a row and save the result with --out."""
    from egocap_eval.harness.result_file import save_result

    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--frames", type=int, default=250)
    parser.add_argument("--size", choices=SIZES, action="append")
    parser.add_argument("--workers", type=int, action="append")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    rows = []
    for name in args.size or SIZES:
        for workers in args.workers or [1, 2]:
            rows.append(measure(SIZES[name], workers, args.frames))
            print(json.dumps({k: v for k, v in rows[-1].items() if k != "memory_mb"}), flush=True)
    if args.out:
        command = shlex.join(["python", "benchmarks/generation.py", *sys.argv[1:]])
        save_result(args.out, {"rows": rows}, command)


if __name__ == "__main__":
    main()
