"""Detector and tracker under faults of rendered images: light, blur, crowds, resolution.

Every level renders the same people and motions with one thing changed, detects and tracks. Error
bars are over the people, of whom there are few: read differences, not decimals.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import arg

import egocap
from egocap.errors import InputError
from egocap.evaluation.scoring import with_detections
from egocap_eval.harness.cases import ScoreLog, Scores, Sweep, run_sweep, sweep_table
from egocap_eval.harness.footage import prepare_sequence, resized
from egocap_eval.harness.score_pose import find_detections
from egocap_eval.harness.study import Outcome
from egocap_sim.scene.config import OthersTable, Scene
from egocap_sim.sensor.config import SensorTable

FIRST_SEED = 400921
MOTIONS = ("walk", "gestures")
NOISE = {"full_well_e": 10000.0, "read_noise": 0.004}  # of an ordinary small sensor
MEASURES = ("pck20", "auc20", "mpjpe_mm", "hidden_mm", "accel_error")

Change = Callable[[Scene], Scene]


def _sensor(**settings: Any) -> Change:
    return lambda scene: scene.model_copy(update={"sensor": SensorTable(**settings)})


def _crowd(count: int) -> Change:
    return lambda scene: scene.model_copy(update={"others": OthersTable(count=count)})


def _resized(width: int) -> Change:
    return lambda scene: resized(scene, (width, width * 4 // 5))


SWEEPS: Mapping[str, Sweep] = {
    "exposure": Sweep("stops", "exposure, with sensor noise",
                      {ev: _sensor(exposure_ev=ev, **NOISE) for ev in (-5, -4, -3, -2, 0, 1, 2)}),
    "blur": Sweep("ms", "shutter time",
                  {ms: _sensor(shutter_s=ms / 1e3) for ms in (0.0, 4.0, 8.0, 16.0, 33.0)}),
    "jpeg": Sweep("quality", "the camera's own JPEG",
                  {q: _sensor(jpeg_quality=q) for q in (10, 25, 50, 75, 95)}),
    "crowd": Sweep("people", "others around the wearer",
                   {n: _crowd(n) for n in (0, 1, 2, 4, 8)}),
    "resolution": Sweep("px wide", "image width",
                        {w: _resized(w) for w in (160, 320, 480, 640, 960, 1280)}),
}  # fmt: skip


def study(
    sweep: Literal["all", "exposure", "blur", "jpeg", "crowd", "resolution"] = "all",
    detections: Annotated[str, arg(metavar="SOURCE")] = "learned",
    work: Annotated[Path, arg(metavar="DIR")] = Path("out/stress"),
    people: int = 4,
    frames: int = 45,
    size: tuple[int, int] = (640, 512),
    workers: int = 1,
    keep: Annotated[Path | None, arg(metavar="FILE")] = None,
) -> Outcome:
    """Render, detect and track under one growing image fault at a time.

    Args:
        sweep: Fault to vary; all by default.
        detections: Source of detections: learned, learned:FILE, or detector:PLUG-IN.
        work: Folder of the sequences; made where they are missing.
        people: People to render at each level, with alternating motions.
        frames: Length of each sequence.
        size: Image width and height, except in the resolution sweep.
        workers: Rendering processes; one is fastest for short sequences.
        keep: Finished scores; the same command continues from them after a stop.
    """
    if people < 2:
        raise InputError(f"{people} people", valid="2 or more, for error bars")
    log = ScoreLog(keep, detections=detections, frames=frames, size=size)
    scenes = [base_scene(i, frames, size) for i in range(people)]
    subjects = {scene.name: scene for scene in scenes}
    names = list(SWEEPS) if sweep == "all" else [sweep]
    found = {}
    for name in names:
        levels = {value: (change, work / name / f"{value:g}")
                  for value, change in SWEEPS[name].levels.items()}  # fmt: skip

        def score(level: tuple[Change, Path], scene: Scene, _: int) -> Scores:
            change, folder = level
            return measure_scene(change(scene), folder / scene.name, detections, workers)

        placed = replace(SWEEPS[name], levels=levels)
        found[name] = run_sweep(name, placed, subjects, score, MEASURES, log=log)
    result = {"sweeps": found, "detections": detections, "people": people, "frames": frames}
    return Outcome(result, [sweep_table(name, found[name], MEASURES) for name in names])


def base_scene(index: int, frames: int, size: tuple[int, int]) -> Scene:
    """One of the people without faults: clean images, no bystanders."""
    motion = MOTIONS[index % len(MOTIONS)]
    return Scene.model_validate({
        "name": f"{motion}-{index}", "frames": frames, "seed": FIRST_SEED + index,
        "rig": {"name": "egorig1", "size": size}, "motion": {"name": motion},
        "place": {"name": "room", "clear_radius": 2.5},
    })  # fmt: skip


def measure_scene(scene: Scene, folder: Path, source: str, workers: int) -> Scores:
    """Measures of a scene that is rendered, detected and tracked."""
    sequence = prepare_sequence(scene, folder, workers)
    found = find_detections(sequence, source)
    tracked = egocap.Tracker(sequence.rig, sequence.body).track(found, sequence.images)
    report = egocap.evaluate(tracked, sequence)
    report = with_detections(report, sequence, found)
    assert report.detections is not None
    seen = {"pck20": report.detections.pck20_seen, "auc20": report.detections.auc20_seen}
    return seen | {name: getattr(report, name) for name in MEASURES if name not in seen}
