"""Accuracy of a rig's pose on the head: fitted from a rig file that is off by a planted amount.

Errors of the pose, their ratio to the stated standard deviations, and the tracked error with the
fitted rig beside that with the true rig, the body fitted in both. A neutral stance is met with an
error of its own, which no detection shows: `stance_deg` is the mean of the true ones.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

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
from egocap.evaluation.table import Table, number
from egocap.fitting.fit_body import first_seconds, fit_body
from egocap.fitting.fit_rig import RigFit, fit_rig, moved_rig, neutral_stances
from egocap.fitting.mount import PARAMETERS
from egocap.geometry import inverse, unit
from egocap_eval.harness.study import Outcome
from egocap_eval.studies.fit_body import person_height

POSITION_MM, ROTATION_DEG, TRACKED_MM = 5.0, 1.0, 3.0
"""Targets: errors of the pose, and of the track above the known mount's."""


def study(
    sequences: Positional[Annotated[tuple[Path, ...], arg(metavar="SEQ")]],
    /,
    detections: Annotated[tuple[str, ...], arg(metavar="SOURCE")] = ("learned",),
    offset_mm: float = 15.0,
    offset_deg: float = 4.0,
    seconds: float = 20.0,
    seed: int = 0,
) -> Outcome:
    """Fit a rig's pose on the head, from a rig file off by a planted offset in a random direction.

    Args:
        sequences: Simulated sequences that begin with half a second of standing.
        detections: Source of detections, as for `egocap track`, for all or one a sequence.
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
        offset = planted(offset_mm, offset_deg, rng)
        observed = first_seconds(detections_from(sequence, source, 0), seconds)
        found[folder.name] = compare(sequence, observed, offset, person_height(folder))
    result = {"summary": summary(found), "sequences": found}
    return Outcome(result, [table(found)], missed(result["summary"]))


def planted(offset_mm: float, offset_deg: float, rng: np.random.Generator) -> Float[Array, "6"]:
    """A rotation vector [rad] and translation [m] of given sizes in random directions."""
    turn, shift = unit(rng.normal(size=(2, 3)))
    return np.concatenate([np.deg2rad(offset_deg) * turn, 1e-3 * offset_mm * shift])


def compare(
    sequence: Sequence, observed: Detections, offset: Float[Array, "6"], height: float
) -> dict[str, Any]:
    """Errors of one sequence: fitted pose, and tracks with the true, fitted and given rig."""
    truth = sequence.true_rig
    given = moved_rig(truth, offset)
    fit = fit_rig(observed, given, height)
    known = fit_body(observed, truth, height)
    joints = sequence.truth.joints_head[: len(observed.times)]
    tracked = {
        "known": track_error(truth, known.proportions, observed, joints),
        "fitted": track_error(fit.rig, fit.body.proportions, observed, joints),
        "given": track_error(given, known.proportions, observed, joints),
    }
    stances = {"stance_deg": stance_error(sequence.truth, len(observed.times))}
    return pose_errors(fit, truth) | stances | {"tracked_mm": tracked}


def stance_error(truth: Truth, count: int) -> float:
    """Angle [deg] of the head's mean attitude in the true neutral stances to level and ahead.

    A person who stands straight faces the world's x axis. Of the first `count` frames.
    """
    from scipy.spatial.transform import Rotation

    seen = np.ones(count, int)
    stances = neutral_stances(truth.time[:count], seen, truth.joints_head[:count], (0.0, 0.5))
    turns = Rotation.from_matrix(truth.T_world_head[:count, :3, :3]).as_rotvec()
    mean = np.mean([turns[frames].mean(0) for frames in stances], axis=0)
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
