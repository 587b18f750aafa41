"""Confidences and warnings of tracks whose inputs are wrong: views, rig, body or detections.

Procedural motions and, where they are given, recorded ones are simulated and not rendered;
detections have all error types of a learned detector. The confidence, the probability that a joint
is within 5 cm, is compared with how often it is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple
from zlib import crc32

import numpy as np
from tyro.conf import arg

import egocap
from egocap.body.labels import EVALUATED, MIRROR
from egocap.body.proportions import Proportions
from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.detect.synthetic import LEARNED_LIKE
from egocap.evaluation.table import Table, number
from egocap.geometry import axis_angle, rigid
from egocap.track.consistency import warning_of
from egocap.track.uncertainty import CORRECT_M
from egocap_eval.harness.cases import Scores, mean, run_cases
from egocap_eval.harness.motion_truth import (
    SimulatedMotion,
    draw_detections,
    simulate_motion,
    simulate_scene,
)
from egocap_eval.harness.study import Outcome
from egocap_eval.studies.recorded import clip_seeds, scenes_of
from egocap_eval.studies.stress import with_baseline

MOTIONS = (("walk", 512311), ("gestures", 512312), ("dribble", 512313), ("juggle", 512316))
"""Motions, and the seeds of their people; others than those that the relation was fitted to."""
MOST_OFF = 0.10
"""Difference of stated confidence and frequency that is accepted."""


class Inputs(NamedTuple):
    """What a tracker is given."""

    found: Detections
    rig: Rig
    body: Proportions


@dataclass(frozen=True)
class Fault:
    """What is wrong with the inputs, and a word of the warning that names it."""

    words: str
    make: Callable[[Inputs, np.random.Generator], Inputs]
    named: str | None  # None: no warning


def _reordered(inputs: Inputs, axis: int, order: Sequence[int]) -> Inputs:
    arrays = {
        name: np.take(values, order, axis)
        for name, values in vars(inputs.found).items()
        if isinstance(values, np.ndarray) and name != "times"
    }
    return inputs._replace(found=replace(inputs.found, **arrays))


def _turned(rig: Rig, cameras: Sequence[int], degrees: float, rng: np.random.Generator) -> Rig:
    mounts = list(rig.mounts)
    for v in cameras:
        axis = rng.normal(size=3)
        T = mounts[v].T_head_camera.copy()
        T[:3, :3] = T[:3, :3] @ axis_angle(axis / np.linalg.norm(axis), np.deg2rad(degrees))
        mounts[v] = replace(mounts[v], T_head_camera=T)
    return replace(rig, mounts=tuple(mounts))


def _turn(cameras: Sequence[int], degrees: float) -> Callable[..., Inputs]:
    return lambda given, rng: given._replace(rig=_turned(given.rig, cameras, degrees, rng))


def _on_head(axis: tuple[float, float, float], degrees: float) -> Callable[..., Inputs]:
    turn = rigid(axis_angle(np.array(axis), np.deg2rad(degrees)), np.zeros(3))

    def make(given: Inputs, rng: np.random.Generator) -> Inputs:
        mounts = (replace(m, T_head_camera=turn @ m.T_head_camera) for m in given.rig.mounts)
        return given._replace(rig=replace(given.rig, mounts=tuple(mounts)))

    return make


def _scaled(factor: float) -> Callable[..., Inputs]:
    return lambda given, rng: given._replace(body=Proportions(given.body.offsets * factor))


def _apart(factor: float) -> Callable[..., Inputs]:
    def make(given: Inputs, rng: np.random.Generator) -> Inputs:
        a, b = (mount.T_head_camera[:3, 3] for mount in given.rig.mounts[:2])
        distance = factor * float(np.linalg.norm(a - b))
        return given._replace(rig=with_baseline(given.rig, distance))

    return make


def _random(given: Inputs, rng: np.random.Generator, *, stuck: bool = False) -> Inputs:
    """Confident detections anywhere; `stuck` at one place each, as of a picture that stands."""
    found, camera = given.found, given.rig.cameras[0]
    shape = found.points.shape[1:] if stuck else found.points.shape
    points = rng.random(shape) * (camera.width, camera.height) - 0.5
    if stuck:
        points = points + rng.normal(size=found.points.shape)
    everywhere = np.ones_like(found.valid)
    sigma = np.where(np.isfinite(found.sigma), found.sigma, 3.0)
    return given._replace(found=replace(
        found, points=points, sigma=sigma, confidence=np.full(found.valid.shape, 0.9),
        valid=everywhere, modes=None, mode_weights=None,
    ))  # fmt: skip


def _half_random(given: Inputs, rng: np.random.Generator) -> Inputs:
    found, other = given.found, _random(given, rng).found
    until = len(found.times) // 2
    arrays = {
        name: np.concatenate([getattr(found, name)[:until], getattr(other, name)[until:]])
        for name in ("points", "sigma", "confidence", "valid")
    }
    return given._replace(found=replace(found, **arrays, modes=None, mode_weights=None))


def _empty(given: Inputs, rng: np.random.Generator) -> Inputs:
    none = np.zeros_like(given.found.valid)
    return given._replace(found=replace(given.found, valid=none, modes=None, mode_weights=None))


FAULTS: Mapping[str, Fault] = {
    "sound": Fault("nothing", lambda given, rng: given, None),
    "exchanged": Fault("views exchanged", lambda g, rng: _reordered(g, 1, (1, 0)), "exchanged"),
    "mirrored": Fault("left and right exchanged", lambda g, rng: _reordered(g, 2, MIRROR),
                      "left and right"),
    "one-5": Fault("one camera rotated by 5 degrees", _turn((1,), 5.0), "rotated"),
    "one-20": Fault("one camera rotated by 20 degrees", _turn((1,), 20.0), "rotated"),
    "each-5": Fault("each camera rotated by 5 degrees", _turn((0, 1), 5.0), "rotated"),
    "each-20": Fault("each camera rotated by 20 degrees", _turn((0, 1), 20.0), "rotated"),
    "roll-20": Fault("rig rolled on the head by 20 degrees", _on_head((1, 0, 0), 20.0), "roll"),
    "pitch-20": Fault("rig pitched on the head by 20 degrees", _on_head((0, 1, 0), 20.0),
                      "pitch"),
    "small-body": Fault("body of 80 % of the size", _scaled(0.8), "limbs"),
    "large-body": Fault("body of 125 % of the size", _scaled(1.25), "limbs"),
    "baseline": Fault("cameras 40 % closer together in the rig file", _apart(0.6), "limbs"),
    "random": Fault("random detections", _random, "nothing"),
    "stuck": Fault("detections that do not move", lambda g, rng: _random(g, rng, stuck=True),
                   "nothing"),
    "half-random": Fault("random detections in the second half", _half_random, "% of the frames"),
    "empty": Fault("no detections", _empty, "hardly any"),
}  # fmt: skip


def study(
    motions: Annotated[Path | None, arg(metavar="DIR")] = None, frames: int = 90, seeds: int = 1
) -> Outcome:
    """Track from wrong inputs: stated confidence against the truth, and what the warning names.

    Exit code 3 when a confidence is off by more than 10 points, or a fault is not named.

    Args:
        motions: Folder of the motion clips, of which those of the validation set are used as well.
        frames: Frames of every motion, of a clip from its middle.
        seeds: Draws of the detections' noise and of the faults.
    """
    simulated = {name: simulate_motion(name, frames=frames, seed=seed) for name, seed in MOTIONS}
    for path, seed in (clip_seeds(motions, "validation", ()) if motions else {}).items():
        simulated[path.stem] = simulate_scene(scenes_of(path, seed, frames)[0])
    runs = run_cases("doubt", FAULTS, simulated, score, seeds=seeds)
    rows = {name: _summary([s for of in runs[name] for s in of]) for name in FAULTS}
    missed = [miss for name, row in rows.items() for miss in _misses(name, row)]
    result = {"detections": LEARNED_LIKE, "motions": list(simulated), "faults": rows}
    return Outcome(result, [table(rows)], missed)


def score(fault: Fault, motion: SimulatedMotion, seed: int) -> Scores:
    """One motion tracked from wrong inputs."""
    given = Inputs(draw_detections(motion, LEARNED_LIKE, seed), motion.rig, motion.proportions)
    found, rig, body = fault.make(given, np.random.default_rng([seed, crc32(motion.name.encode())]))
    track = egocap.Tracker(rig, body).track(found)
    assert track.confidence is not None and track.covariance is not None
    off = np.linalg.norm(track.joints_head - motion.truth.joints_head, axis=-1)[:, EVALUATED]
    warning = warning_of(track)
    named = warning is None if fault.named is None else fault.named in (warning or "")
    return {
        "error_mm": 1e3 * float(off.mean()), "within": float((off < CORRECT_M).mean()),
        "stated": float(track.confidence[:, EVALUATED].mean()),
        "warned": float(warning is not None), "named": float(named), "warning": warning,
    }  # fmt: skip


def _summary(scores: Sequence[Scores]) -> dict[str, Any]:
    values = {name: mean([s[name] for s in scores])
              for name in ("error_mm", "within", "stated", "warned", "named")}  # fmt: skip
    rounded = {name: None if v is None else round(v, 3) for name, v in values.items()}
    return rounded | {"warning": scores[0]["warning"]}


def _misses(name: str, row: Mapping[str, Any]) -> list[str]:
    missed = []
    if abs(row["stated"] - row["within"]) > MOST_OFF:
        missed.append(f"{FAULTS[name].words}: stated {100 * row['stated']:.0f} %, "
                      f"within 5 cm {100 * row['within']:.0f} %")  # fmt: skip
    if row["named"] < 1.0:
        missed.append(f"{FAULTS[name].words}: named in {100 * row['named']:.0f} % of the tracks")
    return missed


def table(rows: Mapping[str, Mapping[str, Any]]) -> Table:
    """A row for each fault of a result."""
    cells = tuple(
        (FAULTS[name].words, number(row["error_mm"], 0), number(100 * row["within"], 0),
         number(100 * row["stated"], 0), number(100 * row["warned"], 0),
         number(100 * row["named"], 0))
        for name, row in rows.items()
    )  # fmt: skip
    header = ("what is wrong", "MPJPE mm", "within 5 cm %", "stated %", "warned %", "named %")
    return Table("Tracks from wrong inputs", header, cells)
