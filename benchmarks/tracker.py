"""Measure the tracker's frames per second on one core, and the compile time of its kernels.

    python benchmarks/tracker.py            # 900 frames
    python benchmarks/tracker.py --json

A synthetic motion of an average person is projected into EgoRig1 at 640 x 512 with 2 px noise; each
view misses 30 % of the joints, independently. Rates include the whole tracker: rays, online filter
forward and backward, smoother, joints. Compilation happens once per machine; it is measured with
an empty cache. Use an otherwise idle machine.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, Literal

ONE_CORE = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")}
os.environ.update(ONE_CORE)  # before numpy is imported

import numpy as np  # noqa: E402

from egocap import Tracker  # noqa: E402
from egocap.body.proportions import Proportions  # noqa: E402
from egocap.body.skeleton import LIMITS, SPREAD, forward  # noqa: E402
from egocap.cameras.rig import Rig  # noqa: E402
from egocap.cameras.rig_files import load_rig  # noqa: E402
from egocap.data.detections import Detections  # noqa: E402
from egocap.detect.synthetic import ProjectedJoints, simulate_detections  # noqa: E402
from egocap.pose.config import TrackerConfig  # noqa: E402
from egocap.pose.pose_prior import load_posture  # noqa: E402

ROOT = Path(__file__).resolve().parents[1]
FPS = 30.0
HIDDEN = 0.3
CASES: dict[str, tuple[str, Literal["interval", "none"]]] = {
    "interval": ("simulated:2.0", "interval"),
    "live": ("simulated:2.0", "none"),
    "interval, outliers": ("simulated:2.0,outliers=0.3", "interval"),
}
COMPILE = (
    "import time; t = time.perf_counter(); from benchmarks.tracker import *; "
    "found, rig, person, _ = make_motion(3); Tracker(rig, person).track(found); "
    "print(time.perf_counter() - t)"
)


def make_motion(
    frames: int, source: str = "simulated:2.0"
) -> tuple[Detections, Rig, Proportions, np.ndarray]:
    """Detections, rig, person and true joints (T, 18, 3) of a smooth motion."""
    rng = np.random.default_rng(0)
    times = np.arange(frames) / FPS
    rates, phases = rng.uniform(0.2, 0.7, (3, 37)), rng.uniform(0, 2 * np.pi, (3, 37))
    waves = np.sin(2 * np.pi * rates * times[:, None, None] + phases).sum(1)
    angles = np.clip(load_posture().mean + 0.3 * SPREAD * waves, LIMITS[:, 0], LIMITS[:, 1])
    person = Proportions.from_lengths(1.75)
    rig = load_rig(ROOT / "scenes/rigs/egorig1.toml").resized(640, 512)
    joints = forward(person, angles)
    pixels, seen = (np.moveaxis(a, 0, 1) for a in rig.project(joints))
    visible = seen & (rng.random(seen.shape) >= HIDDEN)
    found = simulate_detections(
        ProjectedJoints(pixels, visible, seen, times, (640, 512)), source, rng
    )
    return found, rig, person, joints


def compile_seconds() -> float:
    """Time of a fresh process's first three frames with an empty cache."""
    with tempfile.TemporaryDirectory() as cache:
        environment = os.environ | {"NUMBA_CACHE_DIR": cache}
        done = subprocess.run(
            [sys.executable, "-c", COMPILE], cwd=ROOT, env=environment, check=True,
            capture_output=True, text=True,
        )  # fmt: skip
    return float(done.stdout)


def measure(frames: int) -> dict[str, Any]:
    """Frames a second and error of every case, and the compile time."""
    cases = {}
    for name, (source, smoothing) in CASES.items():
        found, rig, person, joints = make_motion(frames, source)
        result = Tracker(rig, person, TrackerConfig(smoothing=smoothing)).track(found)
        error = np.linalg.norm(result.joints_head - joints, axis=-1)[:, 1:].mean()
        cases[name] = {
            "frames_per_second": round(1 / result.seconds_per_frame, 1),
            "mpjpe_mm": round(1e3 * float(error), 1),
        }
    return {"frames": frames, "cases": cases, "compile_s": round(compile_seconds(), 1)}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=900)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    report = measure(options.frames)
    if options.json:
        print(json.dumps(report, indent=1))
        return
    for name, case in report["cases"].items():
        print(f"{name:18} {case['frames_per_second']:8.0f} frames/s {case['mpjpe_mm']:7.1f} mm")
    print(f"first use          {report['compile_s']:8.1f} s, imports and compiling included")


if __name__ == "__main__":
    main()
