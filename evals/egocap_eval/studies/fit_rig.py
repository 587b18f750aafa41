"""Accuracy of a rig's pose on the head: fitted from a rig file that is off by a planted amount.

Errors of the pose, their ratio to the stated standard deviations, and the tracked error with the
fitted rig beside that with the true rig, the body fitted in both. A neutral stance is met with an
error of its own, which no detection shows: `stance_deg` is the mean of the true ones.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from tyro.conf import Positional, arg

from egocap.body.labels import EVALUATED
from egocap.body.proportions import Proportions
from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.data.sequence import Sequence
from egocap.data.truth import Truth
from egocap.detect.sources import detections_from
from egocap.detect.synthetic import LEARNED_LIKE
from egocap.errors import InputError
from egocap.evaluation.table import Table, number
from egocap.fitting.fit_body import first_seconds, fit_body
from egocap.fitting.fit_rig import RigFit, fit_rig, moved_rig
from egocap.fitting.mount import PARAMETERS
from egocap.fitting.stance import neutral_weights
from egocap.geometry import inverse, unit
from egocap_eval.harness.motion_truth import draw_detections, simulate_motion
from egocap_eval.harness.study import Outcome
from egocap_eval.studies.fit_body import person_height

FIRST_PERSON, FPS = 181, 15.0
POSITION_MM, ROTATION_DEG, TRACKED_MM = 5.0, 1.0, 3.0
"""Targets: errors of the pose, and of the track above the known mount's."""


def study(
    sequences: Positional[Annotated[tuple[Path, ...], arg(metavar="SEQ")]] = (),
    /,
    detections: Annotated[tuple[str, ...], arg(metavar="SOURCE")] = ("learned",),
    people: int = 0,
    offset_mm: float = 15.0,
    offset_deg: float = 4.0,
    seconds: float = 20.0,
    seed: int = 0,
) -> Outcome:
    """Fit a rig's pose on the head, from a rig file off by a planted offset in a random direction.

    Args:
        sequences: Simulated sequences that begin with half a second of standing.
        detections: Source of detections, as for `egocap track`, for all or one a sequence.
        people: Of which the guided moves are simulated without pictures, with simulated detections
            like learned ones.
        offset_mm: Planted translation.
        offset_deg: Planted rotation.
        seconds: Length of each sequence that is used.
        seed: Of the directions of the offsets.
    """
    rng = np.random.default_rng(seed)
    sources = detections * len(sequences) if len(detections) == 1 else detections
    found = {}
    for folder, source in zip(sequences, sources, strict=True):
        sequence = Sequence(folder)
        observed = first_seconds(detections_from(sequence, source, 0), seconds)
        case = Case(sequence.true_rig, sequence.truth, observed, person_height(folder))
        found[folder.name] = compare(case, planted(offset_mm, offset_deg, rng))
    for k in range(people):
        offset = planted(offset_mm, offset_deg, rng)
        found[f"person {FIRST_PERSON + k}"] = compare(simulated(FIRST_PERSON + k, seconds), offset)
    if not found:
        raise InputError("nothing to fit", valid="sequences, or --people")
    result = {"summary": summary(found), "sequences": found}
    return Outcome(result, [table(found)], missed(result["summary"]))


class Case(NamedTuple):
    """A recording with its truth."""

    rig: Rig
    truth: Truth
    observed: Detections
    height: float  # metres


def simulated(person: int, seconds: float) -> Case:
    """The guided moves of a person, as `evals/rig-moves.toml` has them, without pictures."""
    motion = simulate_motion("guided", frames=round(seconds * FPS), seed=person, fps=FPS)
    observed = draw_detections(motion, LEARNED_LIKE, person)
    return Case(motion.rig, motion.truth, observed, motion.height_m)


def planted(offset_mm: float, offset_deg: float, rng: np.random.Generator) -> Float[Array, "6"]:
    """A rotation vector [rad] and translation [m] of given sizes in random directions."""
    turn, shift = unit(rng.normal(size=(2, 3)))
    return np.concatenate([np.deg2rad(offset_deg) * turn, 1e-3 * offset_mm * shift])


def compare(case: Case, offset: Float[Array, "6"]) -> dict[str, Any]:
    """Errors of one recording: fitted pose, and tracks with the true, fitted and given rig."""
    truth, observed = case.rig, case.observed
    given = moved_rig(truth, offset)
    fit = fit_rig(observed, given, case.height)
    known = fit_body(observed, truth, case.height)
    joints = case.truth.joints_head[: len(observed.times)]
    tracked = {
        "known": track_error(truth, known.proportions, observed, joints),
        "fitted": track_error(fit.rig, fit.body.proportions, observed, joints),
        "given": track_error(given, known.proportions, observed, joints),
    }
    stances = {"stances": fit.stances,
               "stance_deg": stance_error(case.truth, len(observed.times))}  # fmt: skip
    return pose_errors(fit, truth) | stances | {"tracked_mm": tracked}


def stance_error(truth: Truth, count: int) -> float:
    """Angle [deg] of the head's mean attitude in the true neutral stances to level and ahead.

    A person who stands straight faces the world's x axis. Of the first `count` frames.
    """
    from scipy.spatial.transform import Rotation

    joints = truth.joints_head[:count]
    weights = neutral_weights(truth.time[:count], np.ones(count, int), joints, (0.0, 0.5))[:, 0]
    turns = Rotation.from_matrix(truth.T_world_head[:count, :3, :3]).as_rotvec()
    mean = weights @ turns / weights.sum()
    return round(float(np.rad2deg(np.linalg.norm(mean))), 2)


def track_error(
    rig: Rig, person: Proportions, observed: Detections, joints: Float[Array, "T 18 3"]
) -> float:
    """Mean distance [mm] of the evaluated joints in the head frame."""
    from egocap.track.tracker import Tracker

    off = np.linalg.norm(Tracker(rig, person).track(observed).joints_head - joints, axis=-1)
    return round(1e3 * float(off[:, list(EVALUATED)].mean()), 1)


def pose_errors(fit: RigFit, truth: Rig) -> dict[str, Any]:
    """Errors of the fitted pose by parameter, their sizes and normalised squares."""
    from scipy.spatial.transform import Rotation

    D = fit.rig.T_head_camera[0] @ inverse(truth.T_head_camera[0])
    turn = Rotation.from_matrix(D[:3, :3]).as_rotvec()
    # Of the head's origin: the cameras are far from the axis of a rotation.
    errors = np.concatenate([turn, D[:3, 3]])
    scale = np.repeat([np.rad2deg(1.0), 1e3], 3)
    lines = zip(PARAMETERS, errors * scale, fit.std * scale, strict=True)
    return {
        "position_mm": round(1e3 * float(np.linalg.norm(D[:3, 3])), 2),
        "rotation_deg": round(float(np.rad2deg(np.linalg.norm(turn))), 2),
        "mahalanobis_squared": round(float(errors @ np.linalg.solve(fit.covariance, errors)), 2),
        "parameters": {
            n: {"error": round(float(e), 2), "std": round(float(s), 2)} for n, e, s in lines
        },
    }


def summary(found: dict[str, dict[str, Any]]) -> dict[str, float]:
    """Means over the sequences; the normalised error is 1 for honest standard deviations."""
    rows = list(found.values())
    above = [r["tracked_mm"]["fitted"] - r["tracked_mm"]["known"] for r in rows]
    squared = np.mean([r["mahalanobis_squared"] for r in rows]) / len(PARAMETERS)
    return {
        "position_mm": round(float(np.mean([r["position_mm"] for r in rows])), 2),
        "rotation_deg": round(float(np.mean([r["rotation_deg"] for r in rows])), 2),
        "rotation_worst_deg": max(r["rotation_deg"] for r in rows),
        "stance_deg": round(float(np.mean([r["stance_deg"] for r in rows])), 2),
        "tracked_above_known_mm": round(float(np.mean(above)), 1),
        "normalised_error": round(float(np.sqrt(squared)), 2),
    }


def missed(means: dict[str, float]) -> list[str]:
    """Targets that the means exceed, in words."""
    targets = {"position_mm": POSITION_MM, "rotation_deg": ROTATION_DEG,
               "tracked_above_known_mm": TRACKED_MM}  # fmt: skip
    over = {name: most for name, most in targets.items() if means[name] > most}
    return [f"{name} {means[name]}, not {most:g}" for name, most in over.items()]


def table(found: dict[str, dict[str, Any]]) -> Table:
    """One line a sequence."""
    header = (
        "sequence",
        "position mm",
        "rotation deg",
        "stance deg",
        "known mm",
        "fitted mm",
        "given mm",
    )
    rows = tuple(
        (name, number(r["position_mm"]), number(r["rotation_deg"]),
         number(r["stance_deg"]),
         *(number(r["tracked_mm"][which]) for which in ("known", "fitted", "given")))
        for name, r in found.items()
    )  # fmt: skip
    return Table("rig on the head: errors of its pose, and tracked error by rig", header, rows)
