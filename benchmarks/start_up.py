"""Measure whole commands from start to exit: the first time on a machine, and every other time.

    python benchmarks/start_up.py                 # 3 runs with kept kernels and files, 1 without

`cold` has no compiled kernels and no cached files of an earlier command; bytecode is there. The
scene is validation-walk at its own size, the track that of its first frames. `--out FILE` saves the
result with command, machine and versions.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

FRAMES = 30
COMMANDS = {
    "egocap --help": ("egocap", "--help"),
    "egocap-sim generate validation-walk --frames 30": (
        "egocap_sim", "generate", "validation-walk", "--frames", str(FRAMES), "--out", "WORK/walk"),
    "egocap track WALK": ("egocap", "track", "WORK/walk", "--out", "WORK/walk.track.npz"),
    "egocap-eval pose WALK --track TRACK": (
        "egocap_eval", "pose", "WORK/walk", "--track", "WORK/walk.track.npz"),
}  # fmt: skip
MOST_S = {"egocap-sim generate validation-walk --frames 30": {"warm": 5.0, "cold": 20.0}}


def measure(repeats: int) -> list[dict[str, Any]]:
    """Seconds of every command, each after those before it."""
    rows = []
    with tempfile.TemporaryDirectory() as cache:
        cold = [_times(Path(cache))]
        warm = [_times(Path(cache)) for _ in range(repeats)]
    for name in COMMANDS:
        runs = sorted(run[name] for run in warm)
        rows.append({"command": name, "cold_s": round(cold[0][name], 2),
                     "warm_s": [round(s, 2) for s in runs]})  # fmt: skip
    return rows


def _times(cache: Path) -> dict[str, float]:
    environment = os.environ | {"XDG_CACHE_HOME": str(cache), "NUMBA_CACHE_DIR": f"{cache}/numba"}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    found = {}
    with tempfile.TemporaryDirectory() as work:
        for name, (module, *words) in COMMANDS.items():
            command = [sys.executable, "-m", module, *(w.replace("WORK", work) for w in words)]
            start = time.perf_counter()
            subprocess.run(command, env=environment, check=True, capture_output=True)
            found[name] = time.perf_counter() - start
    return found


def misses(rows: list[dict[str, Any]]) -> list[str]:
    """Which targets are missed, in words; the median of the warm runs counts."""
    found = []
    for row in rows:
        for state, most in MOST_S.get(row["command"], {}).items():
            runs = row["warm_s"] if state == "warm" else [row["cold_s"]]
            if (seconds := runs[len(runs) // 2]) > most:
                found.append(f"{row['command']}, {state}: {seconds:.1f} s (target {most:g} s)")
    return found


def main() -> None:
    """Measure, print one line a command and save the result with --out."""
    from egocap_eval.harness.result_file import save_result

    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    rows = measure(args.repeats)
    for row in rows:
        print(json.dumps(row), flush=True)
    for missed in misses(rows):
        print(f"missed: {missed}")
    if args.out:
        command = shlex.join(["python", "benchmarks/start_up.py", *sys.argv[1:]])
        save_result(args.out, {"rows": rows, "missed": misses(rows)}, command)


if __name__ == "__main__":
    main()
