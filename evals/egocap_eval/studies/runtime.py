"""Measure run times (paper, section 5.2): detector, solvers, and images to poses.

Times are wall clock, the best of several runs, after compilation and loading; the machine's load is
recorded with them. The paper's solvers run at its image sizes and numbers of steps.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from tyro.conf import arg

import egocap
from egocap.body.labels import EVALUATED
from egocap.commandline import progress
from egocap.data.sequence import Sequence as Footage
from egocap.data.sequence import open_sequence
from egocap.detect.input_images import ahead, recorded_pictures
from egocap.detect.sources import detections_from
from egocap.errors import EgocapError, InputError
from egocap.evaluation.table import Table, number
from egocap.pose.config import TrackerConfig
from egocap_eval.detection.detector_speed import measure_speed
from egocap_eval.harness.footage import builtin_scene, prepare_sequence
from egocap_eval.harness.study import Outcome

if TYPE_CHECKING:
    from egocap.data.track import Track
    from egocap.detect.detector import Detector
    from egocap.view.feeds import Instant

SCENE, SOURCE = "validation-walk", "simulated:2.0"
ENGINES = ("openvino-int8", "openvino", "onnxruntime-int8", "onnxruntime", "cuda")
PAPER = {"reference": 1 / 10.0, "stochastic, colours alone": 12.5}  # frames a second
"""The paper's rates of its own solvers on a CPU; of the second, 10 to 15."""


def study(
    sequence: Annotated[Path | None, arg(metavar="SEQ")] = None,
    work: Annotated[Path, arg(metavar="DIR")] = Path("out/runtime"),
    frames: int = 120,
    few: int = 10,
    repeats: int = 3,
    threads: int | None = None,
    size: tuple[int, int] = (640, 512),
) -> Outcome:
    """Time the detector, the solvers, and the pipeline from images to poses.

    Args:
        sequence: Sequence to use; by default the scene validation-walk is generated.
        work: Folder to generate it in.
        frames: Frames to use.
        few: Frames for the paper's solvers, which are slow.
        repeats: Runs of each fast measurement; the best counts.
        threads: Threads of the network; all cores by default.
        size: Image width and height of the generated sequence.
    """
    for count, name, least in ((frames, "frames", 10), (few, "few", 2), (repeats, "repeats", 1)):
        if count < least:
            raise InputError(f"{count} {name}", valid=f"{least} or more")
    footage = _made(work, frames, size) if sequence is None else open_sequence(sequence)
    frames = min(frames, len(footage))
    result = {
        "sequence": footage.manifest.name,
        "size": [footage.rig.cameras[0].width, footage.rig.cameras[0].height],
        "frames": frames, "repeats": repeats, "load": [round(x, 2) for x in os.getloadavg()],
        "solvers": time_solvers(footage, frames, few, repeats),
        "detector": time_engines(footage, frames, repeats, threads),
        "pipeline": time_pipeline(footage, frames, repeats, threads),
        "paper": PAPER,
    }  # fmt: skip
    return Outcome(result, tables(result), config={"sequence": footage.manifest.config_sha256})


def time_solvers(footage: Footage, frames: int, few: int, repeats: int) -> dict[str, Any]:
    """Frames per second and error of every solver, from detections with 2 px noise."""
    from egocap.paper.config import PAPER_SOLVERS, PaperConfig

    found = detections_from(footage, SOURCE, 0)[:frames]
    pictures = [footage.images(t) for t in range(frames)]

    def ours(config: TrackerConfig) -> Callable[[], Track]:
        return lambda: egocap.Tracker(footage.rig, footage.body, config).track(
            found, pictures.__getitem__
        )

    def papers(config: PaperConfig) -> Callable[[], Track]:
        return lambda: egocap.PaperTracker(footage.rig, footage.body, config).track(
            found[:few], pictures.__getitem__
        )

    reference, stochastic = PAPER_SOLVERS["reference"], PAPER_SOLVERS["stochastic"]
    blind = replace(stochastic, lambda_detection=0.0)  # what section 5.2 times
    solvers: Mapping[str, tuple[Callable[[], Track], int]] = {
        "fast": (ours(TrackerConfig()), repeats),
        "fast, live": (ours(TrackerConfig(smoothing="fixed-lag")), repeats),
        "fast, causal filter": (ours(TrackerConfig(smoothing="none")), repeats),
        "fast, with colour": (ours(TrackerConfig(colour=True)), 1),
        "reference": (papers(reference), 1),
        "stochastic": (papers(stochastic), 1),
        "stochastic, colours alone": (papers(blind), repeats),
    }
    timed = {}
    with progress("solvers", len(solvers), unit="solvers") as advance:
        for name, (way, times) in solvers.items():
            tracks = [way() for _ in range(times)]
            best = min(tracks, key=lambda done: done.seconds_per_frame)
            timed[name] = _track_times(best, footage)
            steps = {s: c.iterations for s, c in PAPER_SOLVERS.items()}.get(name.partition(",")[0])
            if steps is not None:
                ms = 1e3 * best.seconds_per_frame / steps
                timed[name] |= {"iterations": steps, "ms_per_iteration": ms}
            advance()
    return timed


def time_engines(
    footage: Footage, frames: int, repeats: int, threads: int | None
) -> dict[str, Any]:
    """Image pairs per second of the detector by engine, or the reason for having none."""
    from egocap.detect.detector import Detector

    timed: dict[str, Any] = {}
    with progress("detector", len(ENGINES), unit="engines") as advance:
        for engine in ENGINES:
            try:
                detector = Detector(footage.rig, engine=engine, threads=threads)
                runs = [measure_speed(footage, detector, threads, frames) for _ in range(repeats)]
                timed[engine] = max(runs, key=lambda run: run["pairs_per_second"])
            except EgocapError as error:
                timed[engine] = {"missing": str(error)}
            advance()
    return timed


def time_pipeline(
    footage: Footage, frames: int, repeats: int, threads: int | None
) -> dict[str, Any]:
    """From compressed images to poses: all frames together, and one after another."""
    from egocap.detect.detector import Detector

    try:
        detector = Detector(footage.rig, threads=threads)
        quick = Detector(footage.rig, threads=threads, streams=1)
    except EgocapError as error:
        return {"missing": str(error)}
    _batch(footage, detector, 5)
    _live(footage, quick, 5)
    batches = [_batch(footage, detector, frames) for _ in range(repeats)]
    lives = [_live(footage, quick, frames) for _ in range(repeats)]
    return {
        "engine": detector.engine.name, "weights": detector.weights.name,
        "batch": max(batches, key=lambda run: run["frames_per_second"]),
        "live": max(lives, key=lambda run: run["frames_per_second"]),
    }  # fmt: skip


def tables(result: Mapping[str, Any]) -> list[Table]:
    """Tables of solvers, engines and pipeline."""
    solvers = tuple(
        (name, number(s["frames_per_second"], 1 if s["frames_per_second"] < 100 else 0),
         number(PAPER.get(name)), number(s.get("ms_per_iteration"), 2), number(s["mpjpe_mm"]))
        for name, s in result["solvers"].items()
    )  # fmt: skip
    engines = tuple(
        (name, s["missing"], "", "") if "missing" in s else
        (name, number(s["pairs_per_second"]), number(1e3 / s["pairs_per_second"]),
         ", ".join(f"{stage} {number(ms)}" for stage, ms in s["stage_cpu_ms"].items()))
        for name, s in result["detector"].items()
    )  # fmt: skip
    ways = tuple(
        (name, number(s["frames_per_second"]),
         ", ".join(f"{stage} {number(ms)}" for stage, ms in s["stages_ms"].items()))
        for name, s in result["pipeline"].items() if isinstance(s, Mapping)
    )  # fmt: skip
    return [
        Table("Solvers", ("solver", "frames/s", "paper", "ms a step", "MPJPE mm"), solvers),
        Table("Detector", ("engine", "pairs/s", "ms a pair", "CPU ms of it"), engines),
        Table("From images to poses", ("", "frames/s", "ms a frame"), ways),
    ]


def _track_times(track: Track, footage: Footage) -> dict[str, Any]:
    true = footage.truth.joints_head[: len(track.times), list(EVALUATED)]
    off = np.linalg.norm(track.joints_head[:, list(EVALUATED)] - true, axis=-1)
    return {"frames_per_second": 1.0 / track.seconds_per_frame, "frames": len(track.times),
            "seconds_per_frame": track.seconds_per_frame, "mpjpe_mm": 1e3 * float(off.mean()),
            "seconds": track.config["seconds"]}  # fmt: skip


def _batch(footage: Footage, detector: Detector, frames: int) -> dict[str, Any]:
    spent: dict[str, float] = {}
    with _lap(spent, "decode and detect", frames):
        found = detector.detect(footage, frames=frames)
    with _lap(spent, "track", frames):
        egocap.Tracker(footage.rig, footage.body).track(found, footage.images)
    return {"frames_per_second": 1e3 / sum(spent.values()), "stages_ms": spent}


@dataclass(frozen=True)
class _Recorded:
    """The first frames of a recording as fast as they are tracked, for a live run."""

    footage: Footage
    frames: int
    skipped: int = 0

    def __iter__(self) -> Iterator[Instant]:
        return ahead(iter(range(self.frames)), self._at, 1)

    def _at(self, t: int) -> Instant:
        from egocap.view.feeds import Instant

        taken = time.monotonic()
        pictures = recorded_pictures(self.footage, t)
        return Instant(float(self.footage.times[t]), pictures, taken, (0.0,) * len(pictures))


def _live(footage: Footage, detector: Detector, frames: int) -> dict[str, Any]:
    """Rate, latency and stages of a live run; pictures are decoded ahead, as cameras' are.

    The stage "decode" is the time that the run waits for pictures.
    """
    from egocap.view.live_run import follow_live

    tracker = egocap.OnlineTracker(footage.rig, footage.body)
    report = follow_live(_Recorded(footage, frames), detector, tracker)
    stages = {"pictures": "decode", "detect": "detect", "track": "track"}
    assert report.latency_ms is not None
    median, late = report.latency_ms
    return {
        "frames_per_second": report.rate,
        "stages_ms": {
            name: 1e3 * float(np.mean(report.stages[stage])) for stage, name in stages.items()
        },
        "latency_ms": {"median": median, "p95": late},
    }


@contextmanager
def _lap(spent: dict[str, float], stage: str, frames: int) -> Iterator[None]:
    """Add the time of a block to a stage, milliseconds per frame."""
    started = time.perf_counter()
    yield
    spent[stage] = spent.get(stage, 0.0) + 1e3 * (time.perf_counter() - started) / frames


def _made(work: Path, frames: int, size: tuple[int, int]) -> Footage:
    scene = builtin_scene(SCENE, size, frames=frames)
    return prepare_sequence(scene, work / f"{SCENE}-{frames}")
