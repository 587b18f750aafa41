"""Measure the speed of `egocap-sim generate` for scenes in episodes, and the cost of an episode.

    python benchmarks/episodes.py      # train-varied and train-chroma, 1 and 2 workers
    python benchmarks/episodes.py --motions CLIPS --frames 1000 --scene train-varied

`fps` is the rate of a whole run with start-up, `steady_fps` the rate after every worker has
finished an episode. `preparation` is the share of one process's time, after its first episode, that
is not spent on rendering and writing frames: person, motion, physics, place, bystanders and
renderer.
`renewal` leaves out motion and physics, whose cost grows with the frames, not with the episodes.
Every worker needs more than one episode. `--out FILE` saves the result with command, machine and
versions.
"""

from __future__ import annotations

import argparse
import json
import shlex
import sys
import tempfile
import time
from itertools import product
from pathlib import Path
from typing import Any
from unittest import mock

SCENES = ("train-varied", "train-chroma")


def measure(name: str, clips: Path | None, workers: int, frames: int) -> dict[str, Any]:
    """Generate a recording into a temporary folder, then its episodes in this process."""
    from egocap_sim.core.resources import builtin_file
    from egocap_sim.record.recorder import generate
    from egocap_sim.scene.config import Scene, load_scene

    content = load_scene(builtin_file("scene", name)).model_dump()
    content["frames"] = frames
    content["episodes"]["clips"] = None if clips is None else str(clips)
    scene = Scene.model_validate(content)
    marks: list[tuple[float, int]] = []

    def on_frames(count: int) -> None:
        marks.append((time.perf_counter(), count))

    with tempfile.TemporaryDirectory() as folder:
        summary = generate(scene, Path(folder) / "r", workers=workers, on_frames=on_frames)
    if summary.episodes <= workers:
        raise SystemExit(f"{summary.episodes} episodes for {workers} workers: use more --frames")
    begun, ended = marks[workers][0], marks[-1][0]
    steady = sum(count for _, count in marks[workers + 1 :]) / (ended - begun)
    return {
        "scene": name, "workers": workers, "frames": frames, "episodes": summary.episodes,
        "fps": round(summary.frames_per_second, 2), "steady_fps": round(steady, 2),
        "mb_per_frame": round(summary.bytes / frames / 1e6, 2), **_preparation(scene),
    }  # fmt: skip


def _preparation(scene: Any) -> dict[str, float]:
    """Time outside rendering and writing, as a share and in seconds an episode."""
    from egocap_sim.record import sequence_recorder
    from egocap_sim.record.episode_plan import find_clips, plan_episodes
    from egocap_sim.record.episode_recorder import EpisodeTask
    from egocap_sim.world import world

    folder = scene.episodes.clips
    clips = () if folder is None else find_clips(Path(folder), strict=False)
    spent = {"write_shard": 0.0, "simulate_take": 0.0}  # seconds

    def timed(module: Any, name: str) -> Any:
        function = getattr(module, name)

        def call(*args: Any) -> Any:
            start = time.perf_counter()
            try:
                return function(*args)
            finally:
                spent[name] += time.perf_counter() - start

        return mock.patch.object(module, name, call)

    start, jobs, task = 0.0, plan_episodes(scene, [scene.frames]), EpisodeTask(scene, clips)
    written, simulated = timed(sequence_recorder, "write_shard"), timed(world, "simulate_take")
    with tempfile.TemporaryDirectory() as made, written, simulated:
        for job in jobs:
            if job.index == 1:
                start = time.perf_counter()
                spent.update(dict.fromkeys(spent, 0.0))
            task.make(job, Path(made) / str(job.index))
    seconds = time.perf_counter() - start
    preparing = seconds - spent["write_shard"]
    return {
        "preparation": round(preparing / seconds, 4),
        "preparation_s": round(preparing / (len(jobs) - 1), 3),
        "renewal": round((preparing - spent["simulate_take"]) / seconds, 4),
    }


def main() -> None:
    """Measure, print one line a scene and save the result with --out."""
    from egocap_eval.harness.result_file import save_result

    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--scene", choices=SCENES, action="append")
    parser.add_argument("--motions", type=Path, help="clips to mix in")
    parser.add_argument("--frames", type=int, default=1000)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    rows = []
    for name, workers in product(args.scene or SCENES, args.workers):
        rows.append(measure(name, args.motions, workers, args.frames))
        print(json.dumps(rows[-1]), flush=True)
    if args.out:
        command = shlex.join(["python", "benchmarks/episodes.py", *sys.argv[1:]])
        save_result(args.out, {"rows": rows}, command)


if __name__ == "__main__":
    main()
