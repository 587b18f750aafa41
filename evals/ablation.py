"""What each part of the tracker is worth (paper, section 5.5): the whole without it, over people.

The paper leaves out smoothness, colour and detections: 30 mm and 5 mm worse, and a lost track. Here
every improvement of ours is left out in turn, too. Each scene is acted by its own person and by
others; every sequence is tracked from several draws of the detections.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import arg

from egocap.cli import detections_from
from egocap.commandline import progress
from egocap.detect.simulated import LEARNED_LIKE
from egocap.errors import InputError
from egocap.evaluate.table import Table, number
from egocap.labels import EVALUATED, LOWER, UPPER
from egocap.results import Detections
from egocap.sequence import VISIBLE, Sequence, open_sequence
from egocap.track.config import TrackerConfig
from egocap.track.tracker import track
from egocap_sim.builtin import builtin_file
from egocap_sim.record import generate
from egocap_sim.scene import Scene, load_scene
from evals.study import Outcome

SCENES = ("validation-walk", "validation-gesture")
OTHER_PEOPLE = 401_000
"""Seed of the second person of the first scene; further ones count up from it."""
WHOLE, BLIND, COLOUR = "whole", "without detections", "with colour"
VARIANTS: Mapping[str, Mapping[str, Any]] = {
    WHOLE: {},
    "without motion prior": {"lambda_motion": 0.0},
    "without posture prior": {"lambda_posture": 0.0},
    "past only": {"smoothing": "none"},
    "without smoothness": {"smoothing": "none", "lambda_smooth": 0.0},
    "without other modes": {"modes": False},
    "without undoing swaps": {"swaps": False},
    "without recalibration": {"recalibrate": False},
    "without any of these": {
        "lambda_motion": 0.0, "modes": False, "swaps": False, "recalibrate": False,
    },
    BLIND: {},
    COLOUR: {"colour": True},
}  # fmt: skip
"""Settings by what they leave out or add."""
LOST_MM = 150.0
"""A frame whose joints are off by more on average is lost."""


@dataclass(frozen=True)
class Row:
    """One variant: means over scenes, people and draws; `scatter_mm` over people and draws."""

    variant: str
    mpjpe_mm: float
    scatter_mm: float
    change_mm: float  # against the whole
    upper_mm: float
    lower_mm: float
    seen_mm: float
    hidden_mm: float
    lost_share: float
    frames_per_second: float


def study(
    work: Annotated[Path, arg(metavar="DIR")] = Path("out/ablation"),
    detections: str = LEARNED_LIKE,
    people: int = 3,
    seeds: int = 2,
    frames: int = 250,
    size: tuple[int, int] = (640, 512),
    workers: int = 2,
    colour: bool = False,
) -> Outcome:
    """Track with one part left out at a time (paper, section 5.5).

    Args:
        work: Folder of the sequences; made where they are missing.
        detections: Simulated detections to track from.
        people: How many people act each scene: its own and others.
        seeds: Draws of the detections' errors.
        frames: Frames of each scene.
        size: Image width and height, pixels.
        workers: Rendering processes.
        colour: Also track with the colour term, which takes minutes a scene.
    """
    if people < 1 or seeds < 1 or frames < 1:
        raise InputError(f"{people} people, {seeds} seeds, {frames} frames", valid="1 or more each")
    sequences = [_made(scene, work, workers) for scene in _scenes(people, frames, size)]
    names = [name for name in VARIANTS if colour or name != COLOUR]
    measured = {name: _measure(name, sequences, detections, seeds) for name in names}
    whole = float(np.mean([m["mpjpe"] for m in measured[WHOLE]]))
    rows = [_row(name, found, whole) for name, found in measured.items()]
    result = {"protocol": "egocap-17", "detections": detections, "people": people, "seeds": seeds,
              "rows": [{k: round(v, 3) if isinstance(v, float) else v for k, v in vars(r).items()}
                       for r in rows]}  # fmt: skip
    header = ("variant", "MPJPE mm", "+-", "change", "upper", "lower", "seen", "hidden", "lost %",
              "frames/s")  # fmt: skip
    table = Table("Tracking with one part left out", header, tuple(
        (r.variant, number(r.mpjpe_mm), number(r.scatter_mm), number(r.change_mm),
         number(r.upper_mm), number(r.lower_mm), number(r.seen_mm), number(r.hidden_mm),
         number(100 * r.lost_share), number(r.frames_per_second, 0))
        for r in rows
    ))  # fmt: skip
    return Outcome(result, [table])


def _scenes(people: int, frames: int, size: tuple[int, int]) -> list[Scene]:
    scenes = []
    for i, name in enumerate(SCENES):
        scene = load_scene(builtin_file("scene", name))
        rig = scene.rig.model_copy(update={"size": size})
        scene = scene.model_copy(update={"rig": rig, "frames": min(frames, scene.frames)})
        for person in range(people):
            seed = scene.seed if person == 0 else OTHER_PEOPLE + 100 * i + person
            scenes.append(scene.model_copy(update={"seed": seed, "name": f"{name}-{person}"}))
    return scenes


def _made(scene: Scene, work: Path, workers: int) -> Sequence:
    with progress(scene.name, scene.frames) as advance:
        generate(scene, work / scene.name, workers=workers, on_frames=advance)
    return open_sequence(work / scene.name)


def _measure(
    variant: str, sequences: list[Sequence], source: str, seeds: int
) -> list[dict[str, float]]:
    config = TrackerConfig(**VARIANTS[variant])
    found = []
    for sequence in sequences:
        for seed in range(seeds):
            detections = detections_from(sequence, source, seed)
            if variant == BLIND:
                detections = _blind(detections)
            images = lambda t, s=sequence: s.frame(t).images  # noqa: E731
            result = track(detections, sequence.rig, sequence.proportions, config, images)
            truth = sequence.truth
            error = 1e3 * np.linalg.norm(result.joints_head - truth.joints_head, axis=-1)
            seen = np.any(truth.visibility == VISIBLE, axis=1)
            counted = np.isin(np.arange(18), EVALUATED)
            found.append({
                "mpjpe": float(error[:, counted].mean()),
                "upper": float(error[:, UPPER].mean()), "lower": float(error[:, LOWER].mean()),
                "seen": float(error[seen & counted].mean()),
                "hidden": float(error[~seen & counted].mean()),
                "lost": float((error[:, counted].mean(1) > LOST_MM).mean()),
                "rate": 1.0 / result.seconds_per_frame,
            })  # fmt: skip
    return found


def _blind(detections: Detections) -> Detections:
    """The same times with nothing detected."""
    return replace(detections, valid=np.zeros_like(detections.valid))


def _row(name: str, found: list[dict[str, float]], whole: float) -> Row:
    mean = {key: float(np.mean([m[key] for m in found])) for key in found[0]}
    return Row(
        name, mean["mpjpe"], float(np.std([m["mpjpe"] for m in found])), mean["mpjpe"] - whole,
        mean["upper"], mean["lower"], mean["seen"], mean["hidden"], mean["lost"],
        min(m["rate"] for m in found),
    )  # fmt: skip
