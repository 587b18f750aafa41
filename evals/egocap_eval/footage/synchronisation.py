"""Lag, clock drift and colours between views, estimated from exported camera files.

Every case is simulated with two clocks, exported as H.264 videos (`egocap-sim export --format
videos`) and given to the import of footage, which sees files and the rig alone. Frames that the
import does not report as lost or repeated count as unreported.
"""

from __future__ import annotations

import logging
import shutil
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import arg

from egocap.data.footage import Footage
from egocap.data.sequence import Sequence
from egocap.errors import InputError
from egocap.evaluation.table import Table, number
from egocap.footage.clocks import view_signals
from egocap.footage.importing import import_footage
from egocap.footage.scan import ViewScan
from egocap.footage.sources import scan_name
from egocap.footage.synchronisation import estimate_clock
from egocap.schema import read_json
from egocap_eval.harness.footage import builtin_scene, prepare_sequence, with_clip
from egocap_eval.harness.study import Outcome
from egocap_sim.export.formats import export
from egocap_sim.export.videos import PLANTED
from egocap_sim.scene.config import RecordTable, Scene
from egocap_sim.sensor.config import SensorTable

log = logging.getLogger(__name__)

FPS = 30000 / 1001
TARGET_MS, TARGET_PPM = 3.0, 20.0


@dataclass(frozen=True)
class Case:
    """A scene with two clocks."""

    scene: str
    seconds: float
    sensor: Mapping[str, Any]
    clip: str | None = None  # of the folder of motions
    seed: int = 1


CASES: Mapping[str, Case] = {
    "walk": Case("validation-walk", 30,
                 {"time_offset_s": 0.0123, "clock_drift_ppm": 40.0}, seed=71),
    "gesture": Case("validation-gesture", 25,
                    {"preset": "webcam", "drop_rate": 0.0, "subframes": 3,
                     "time_offset_s": -0.021, "clock_drift_ppm": -60.0}, seed=72),
    "clip": Case("validation-walk", 10,
                 {"preset": "action-camera", "subframes": 3,
                  "time_offset_s": 0.0057, "clock_drift_ppm": 25.0}, "bvh/001_01.bvh", seed=73),
    "headset": Case("vr", 10,
                    {"preset": "consumer", "subframes": 3,
                     "time_offset_s": 0.015, "clock_drift_ppm": -30.0}, seed=74),
    "signal": Case("validation-walk", 26,
                   {"preset": "consumer", "subframes": 3,
                    "time_offset_s": -0.0133, "clock_drift_ppm": 50.0},
                   "npz/basketball_signal_3.npz", seed=700_075),
}  # fmt: skip
"""Validation scenes, a training and a validation clip, two rigs, five sensors."""


def study(
    work: Annotated[Path, arg(metavar="DIR")] = Path("out/sync"),
    motions: Annotated[Path | None, arg(metavar="DIR")] = None,
    cases: tuple[str, ...] = tuple(CASES),
    size: tuple[int, int] = (480, 384),
    workers: int = 1,
) -> Outcome:
    """Estimate lag, drift and colours between exported camera files, against what was planted.

    Args:
        work: Folder of sequences, videos and imports; sequences are made where they are missing.
        motions: Folder of recorded motions; without it, cases that need one are left out.
        cases: Cases to measure.
        size: Image width and height.
        workers: Rendering processes.
    """
    if unknown := [case for case in cases if case not in CASES]:
        raise InputError(f"unknown case '{unknown[0]}'", valid=CASES)
    found = {}
    for name in cases:
        scene = case_scene(name, size, motions)
        if scene is None:
            log.warning("%s is left out: it needs --motions", name)
            continue
        sequence = prepare_sequence(scene, work / "sequences" / name, workers)
        found[name] = measure(sequence, work / "videos" / name, work / "imports" / name)
    missed = [f"{name}: {what}" for name, row in found.items() for what in clock_misses(row)]
    return Outcome({"cases": found}, [_table(found)], missed)


def measure(sequence: Sequence, videos: Path, imported: Path) -> dict[str, Any]:
    """Export a sequence, import it, and compare the second view's clock with the planted one."""
    for folder in (videos, imported):
        if folder.exists():
            shutil.rmtree(folder)
    export(sequence, "videos", videos)
    planted = read_json(videos / PLANTED)["views"]
    views = list(planted)
    started = time.process_time()
    found = import_footage([videos / f"{v}.mp4" for v in views], videos / "rig.json", imported)
    spent = time.process_time() - started
    assert found.footage is not None
    return clock_scores(sequence, planted, found.footage) | {
        "cpu_ms_per_frame": 1e3 * spent / len(sequence), "pictures": _without_sound(found, planted),
    }  # fmt: skip


def _without_sound(imported: Sequence, planted: Mapping[str, Any]) -> dict[str, float | None]:
    """Drift of the second view's clock from the pictures alone, against the planted one."""
    assert imported.footage is not None
    scans = [ViewScan.load(imported.folder / scan_name(view, imported.rig))
             for view in imported.footage.views]  # fmt: skip
    timing = estimate_clock(*(view_signals(scan, None) for scan in scans[:2])).timing
    told = list(planted.values())[1]
    return {"drift_error_ppm": timing.drift_ppm - told["drift_ppm"],
            "drift_std_ppm": timing.drift_std_ppm}  # fmt: skip


def clock_scores(
    sequence: Sequence, planted: Mapping[str, Any], footage: Footage
) -> dict[str, Any]:
    """Errors of the second view's clock and colours, and pictures lost or repeated unreported.

    `planted` are the views of planted.json; `footage` is what the import found.
    """
    views = list(planted)
    timing, told = footage.views[1].timing, planted[views[1]]
    offset = timing.offset_s - told["offset_s"]
    drift = timing.drift_ppm - told["drift_ppm"]
    middle = 0.5 * len(told["places"]) / sequence.manifest.fps
    report, gain = footage.report, footage.views[1].colour.gain
    missing = [
        len(planted[v][kind]) - int(report[v][word])
        for v in views for kind, word in (("lost", "dropped"), ("repeated", "repeated"))
    ]  # fmt: skip
    return {
        "seconds": len(sequence) / sequence.manifest.fps,
        "lag_error_ms": 1e3 * (offset + 1e-6 * drift * middle),
        "lag_error_start_ms": 1e3 * offset,
        "lag_std_ms": None if timing.offset_std_s is None else 1e3 * timing.offset_std_s,
        "drift_error_ppm": drift,
        "drift_std_ppm": timing.drift_std_ppm,
        "note": timing.note,
        "unreported": sum(max(count, 0) for count in missing),
        "invented": sum(max(-count, 0) for count in missing),
        "colour_error_percent": _colour_error(sequence, planted, gain),
    }


def _colour_error(
    sequence: Sequence, planted: Mapping[str, Any], gain: tuple[float, float, float]
) -> float:
    """Largest error of a gain against the planted ones and the sensors' own exposures."""
    first, other = (np.array(view["gain"]) for view in planted.values())
    stops = np.zeros(2) if sequence.sensor is None else sequence.sensor.exposure_ev.mean(0)
    wanted = np.sqrt(first / other * 2.0 ** (stops[0] - stops[1]))
    return float(100 * np.abs(np.array(gain) / wanted - 1.0).max())


def clock_misses(row: Mapping[str, Any]) -> list[str]:
    """Which targets a row of scores misses, in words."""
    missed = []
    if abs(row["lag_error_ms"]) > TARGET_MS:
        missed.append(f"lag off by {row['lag_error_ms']:.1f} ms (target {TARGET_MS:g})")
    if abs(row["drift_error_ppm"]) > TARGET_PPM:
        missed.append(f"drift off by {row['drift_error_ppm']:.0f} ppm (target {TARGET_PPM:g})")
    if row["unreported"]:
        missed.append(f"{row['unreported']} lost or repeated frames not reported")
    return missed


def _table(found: Mapping[str, Mapping[str, Any]]) -> Table:
    rows = tuple(
        (name, number(row["seconds"], 0), number(row["lag_error_ms"], 2),
         number(row["lag_std_ms"], 2), number(row["drift_error_ppm"], 0),
         number(row["drift_std_ppm"], 0), *(number(row["pictures"][key], 0) for key in
                                            ("drift_error_ppm", "drift_std_ppm")),
         str(row["unreported"]), str(row["invented"]),
         number(row["colour_error_percent"]), number(row["cpu_ms_per_frame"], 0))
        for name, row in found.items()
    )  # fmt: skip
    return Table(
        "Clock and colours of the second view against what was planted",
        ("case", "s", "lag error ms", "+- ms", "drift error ppm", "+- ppm", "by pictures alone",
         "+- ppm", "unreported frames", "invented", "colour error %", "CPU ms a frame"), rows,
    )  # fmt: skip


def case_scene(name: str, size: tuple[int, int], motions: Path | None) -> Scene | None:
    """The scene of a case; None without the motions that it needs."""
    case = CASES[name]
    if case.clip is not None and motions is None:
        return None
    scene = builtin_scene(case.scene, size).model_copy(update={
        "name": name, "fps": FPS, "seed": case.seed, "frames": int(case.seconds * FPS),
        "sensor": SensorTable(**case.sensor), "record": RecordTable(masks=False),
    })  # fmt: skip
    if case.clip is None:
        return scene
    assert motions is not None
    return with_clip(scene, motions / case.clip, scene.frames)
