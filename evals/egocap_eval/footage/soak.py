"""Long runs: memory, open files and latency of `live`, and memory of generation, over time.

`egocap live` follows looping films by their clock, `egocap-sim generate` makes many small frames,
each in processes of its own whose memory and open files are read every few seconds.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import arg

from egocap.errors import InputError, MachineError
from egocap.evaluation.table import Table, number
from egocap_eval.footage.memory import write_loop
from egocap_eval.footage.process import family, memory_mb
from egocap_eval.harness.footage import builtin_scene, prepare_sequence
from egocap_eval.harness.study import Outcome
from egocap_sim.scene.config import RecordTable

MOST_GROWTH_MB, MOST_LATENCY_MS = 20.0, 100.0
_HZ, _EVERY_S, _FEWEST = 30, 2.0, 50  # of the films; between samples; samples


def study(
    minutes: float = 60.0,
    frames: int = 100_000,
    size: tuple[int, int] = (320, 256),
    unique: int = 150,
    work: Annotated[Path, arg(metavar="DIR")] = Path("out/soak"),
) -> Outcome:
    """Run live and generation for long; measure growth of memory, open files and latency.

    Args:
        minutes: Duration of live.
        frames: Stereo frames to generate; 0: none.
        size: Image width and height.
        unique: Frames of the sequence, which is played forwards and backwards.
        work: Folder of the sequence, the films and what is generated.
    """
    if minutes <= 0 or frames < 0:
        raise InputError("minutes are above 0, frames at least 0")
    scene = builtin_scene("validation-walk", size, frames=unique, record=RecordTable(masks=False))
    sequence = prepare_sequence(scene, work / "sequence")
    films = [work / f"{view}.mp4" for view in sequence.rig.views]
    for v, film in enumerate(films):
        pictures = [frame.images[v] for frame in sequence]
        write_loop(film, pictures, int(60 * _HZ * (minutes + 0.5)))
    live = watch(["egocap", "live", *map(str, films), "--rig", str(sequence.folder / "rig.json"),
                  "--body", str(sequence.folder / "body.json"), "--realtime", "--json",
                  "--out", str(work / "live.npz"), "--seconds", str(60 * minutes)])  # fmt: skip
    report = json.loads(live.pop("printed"))
    live |= {key: report[key] for key in ("poses", "latency_ms", "latency_95_ms")}
    missed = _missed("live", live)
    if live["latency_95_ms"] is None:
        missed.append("live: no pose before the end of the films")
    elif live["latency_95_ms"] > MOST_LATENCY_MS:
        missed.append(f"live: latency {live['latency_95_ms']:.0f} ms (95 %, target "
                      f"{MOST_LATENCY_MS:g})")  # fmt: skip
    result = {"minutes": minutes, "live": live}
    if frames:
        out = work / "generated"
        shutil.rmtree(out, ignore_errors=True)
        words = ["generate", "validation-walk", "--frames", str(frames), "--size",
                 *map(str, size), "--no-masks", "--workers", "1", "--out", str(out)]  # fmt: skip
        made = watch(["egocap_sim", *words])
        shutil.rmtree(out)
        made.pop("printed")
        result |= {"frames": frames, "generate": made}
        missed += _missed("generate", made)
    return Outcome(result, [_table(result)], missed)


def watch(words: Sequence[str]) -> dict[str, Any]:
    """Run `python -m` with these words; memory and open files over time, and what it printed.

    `growth_mb`, of memory without pages of files, and `files_growth` compare the medians of the
    last fifth of the run with the second; None for a run of few samples, mostly the start.
    Raises MachineError if the command fails.
    """
    samples: list[tuple[float, int]] = []
    peak = 0.0
    with subprocess.Popen([sys.executable, "-m", *words], stdout=subprocess.PIPE,
                          stderr=subprocess.DEVNULL, text=True) as process:  # fmt: skip
        while process.poll() is None:
            pids = family(process.pid)
            held = [memory_mb(pid) for pid in pids]
            peak = max(peak, sum(memory.all for memory in held))
            own = sum(memory.own for memory in held)
            samples.append((own, sum(map(_open_files, pids))))
            time.sleep(_EVERY_S)
        assert process.stdout is not None
        printed = process.stdout.read()  # a summary, shorter than the pipe
    if process.returncode:
        raise MachineError(f"'{' '.join(words[:3])} ...' exited with {process.returncode}")
    found: dict[str, Any] = dict.fromkeys(("growth_mb", "files_growth"))
    found |= {"peak_mb": peak, "samples": len(samples), "printed": printed}
    if (fifth := len(samples) // 5) >= _FEWEST // 5:
        early = np.median(samples[fifth : 2 * fifth], axis=0)
        late = np.median(samples[-fifth:], axis=0)
        found |= zip(("growth_mb", "files_growth"), map(float, late - early), strict=True)
    return found


def _open_files(pid: int) -> int:
    with suppress(OSError):
        return sum(1 for _ in Path(f"/proc/{pid}/fd").iterdir())
    return 0


def _missed(name: str, run: dict[str, Any]) -> list[str]:
    if run["growth_mb"] is None:
        return [f"{name}: too short to tell growth, {run['samples']} samples"]
    missed = []
    if run["growth_mb"] > MOST_GROWTH_MB:
        missed.append(f"{name}: memory grows by {run['growth_mb']:.0f} MB (target "
                      f"{MOST_GROWTH_MB:g})")  # fmt: skip
    if run["files_growth"] > 0:
        missed.append(f"{name}: {run['files_growth']:g} more open files at the end")
    return missed


def _table(result: dict[str, Any]) -> Table:
    rows = []
    for name in ("live", "generate"):
        if name in result:
            run = result[name]
            late = number(run["latency_95_ms"], 0) if run.get("latency_95_ms") else ""
            rows.append((name, number(run["peak_mb"], 0), number(run["growth_mb"], 1),
                         number(run["files_growth"], 0), late))  # fmt: skip
    head = ("command", "peak MB", "growth MB", "files", "latency 95 % ms")
    return Table("Long runs", head, tuple(rows))
