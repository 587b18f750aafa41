"""Convergence of the image model to the true pose: perturbed, with detections, online.

The part of `egocap-eval image-model` that estimates poses in simulated sequences. The truth is used
only to perturb the start and to score.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.labels import LABEL_INDEX, LOWER, UPPER
from egocap.body.skeleton import DOF_COUNT, DOFS
from egocap.data.sequence import Sequence
from egocap.data.truth import VISIBLE
from egocap.image_model.colour_measure import PAPER
from egocap.image_model.colour_solver import UPPER_BODY, ImageSolver, ImageSolverConfig
from egocap.pose.inverse_kinematics import nearest_angles
from egocap.track.colour_tracker import ColourTracker
from egocap_eval.image_model.scene import Scene, Trial

PERTURBATIONS_DEG = (2.0, 5.0, 10.0, 15.0, 20.0)
OFFSETS_DEG = tuple(range(-20, 21, 4))
CLOSE_M = 0.03
NEAR_DEG = 4.0
LOST_MM = 150.0


def basin_study(
    scenes: list[Scene], trials: int, rng: np.random.Generator
) -> dict[str, dict[str, dict[str, float]]]:
    """Share of perturbed poses that return to under 30 mm, by the angles and data used.

    Every angle is drawn uniformly from plus or minus the size, `trials` times per scene. `visible`
    counts only joints that are visible in a view. The last two use the paper's measure, which has
    no background model.
    """
    tasks: dict[str, Callable[[Scene, float], Trial]] = {
        "colour, upper body": lambda scene, size: scene.trial(size, rng, UPPER_BODY),
        "colour, all angles": lambda scene, size: scene.trial(size, rng),
        "colour and detections": lambda scene, size: scene.trial(size, rng, pixels=2.0),
        "detections": lambda scene, size: scene.trial(size, rng, pixels=2.0, weight=0.0),
        "paper's colour, upper body": lambda scene, size: scene.trial(
            size, rng, UPPER_BODY, measure=PAPER
        ),
        "paper's colour and detections": lambda scene, size: scene.trial(
            size, rng, pixels=2.0, measure=PAPER
        ),
    }
    return {
        name: {
            f"{size:.0f}_deg": _summary([run(s, size) for s in scenes for _ in range(trials)])
            for size in PERTURBATIONS_DEG
        }
        for name, run in tasks.items()
    }


def detection_study(scenes: list[Scene], frames: int, rng: np.random.Generator) -> dict[str, Any]:
    """Mean error with and without colour beside detections of 2 and 4 pixels at 640 x 512.

    Every frame is solved by itself, first from detections alone, starting 5 degrees off; colour
    starts from that result.
    """
    result: dict[str, Any] = {}
    for pixels in (2.0, 4.0):
        entry: dict[str, Any] = {}
        for scene in scenes:
            picked = np.linspace(0, len(scene.poses) - 1, frames).round().astype(int)
            rows = [scene.compare(int(t), pixels, rng) for t in picked]
            without, with_ = (np.mean([row[k] for row in rows], 0) for k in (0, 1))
            entry[scene.name] = {
                "detections_mm": round(1e3 * float(without[0]), 1),
                "with_colour_mm": round(1e3 * float(with_[0]), 1),
                "detections_visible_mm": round(1e3 * float(without[1]), 1),
                "with_colour_visible_mm": round(1e3 * float(with_[1]), 1),
            }
        names = next(iter(entry.values()))
        entry["mean"] = {
            name: round(float(np.mean([e[name] for e in entry.values()])), 1) for name in names
        }
        result[f"simulated_{pixels:.0f}_px"] = entry
    return result


def live_study(folder: Path, frames: int) -> dict[str, Any]:
    """The paper's live test: no detector, from a known first pose. Errors are the upper body's.

    `egocap.track.colour_tracker` learns the colours in the first images. An arm is lost in the
    frames in which its wrist is off by more than `LOST_MM`.
    """
    sequence = Sequence(folder)
    truth = sequence.truth
    start = nearest_angles(sequence.body, truth.joints_head[0])
    tracker = ColourTracker(sequence.rig, sequence.body, start)
    count = min(frames, len(sequence))
    shown = (sequence.frame(t) for t in range(count))
    poses = [pose for frame in shown for pose in tracker.step(frame.images, frame.time)]
    found = np.array([pose.joints_head for pose in poses])
    wrong = 1e3 * np.linalg.norm(found - truth.joints_head[:count], axis=-1)
    seen = (truth.visibility[:count] == VISIBLE).any(1)[:, UPPER]
    errors = wrong[:, UPPER]
    lost = {side: wrong[:, LABEL_INDEX[f"{side}_wrist"]] > LOST_MM for side in ("left", "right")}
    return {
        "frames": count,
        "mean_mm": round(float(errors.mean()), 1),
        "mean_visible_mm": round(float(errors[seen].mean()), 1),
        "median_mm": round(float(np.median(errors)), 1),
        "last_50_mm": round(float(errors[-50:].mean()), 1),
        "worst_frame_mm": round(float(errors.mean(1).max()), 1),
        "legs_mm": round(float(wrong[:, LOWER].mean()), 1),
        "lost_frames": {side: int(frames.sum()) for side, frames in lost.items()},
    }


def _summary(trials: list[Trial]) -> dict[str, float]:
    before, after, visible = (
        np.array([getattr(t, n) for t in trials]) for n in ("before", "after", "visible")
    )
    return {
        "start_mm": round(1e3 * float(before.mean()), 1),
        "median_mm": round(1e3 * float(np.median(after)), 1),
        "median_visible_mm": round(1e3 * float(np.median(visible)), 1),
        "share_under_30_mm": float(np.mean(after < CLOSE_M)),
        "share_visible_under_30_mm": float(np.mean(visible < CLOSE_M)),
    }


def profile_study(scenes: list[Scene]) -> dict[str, Any]:
    """Energy along every one of the 37 angles about the true pose, the other 36 at the truth.

    In the middle frame of each scene: of colour alone, and of colour with detections of 2 pixels
    and the priors. `lowest_deg` is the mean distance of the lowest of the offsets from the truth,
    `near` the share of angles where that is at most `NEAR_DEG`. Energies are less the curve's
    lowest, in units of the negative log-posterior.
    """
    result: dict[str, Any] = {"offset_deg": list(OFFSETS_DEG), "angles": list(DOFS), "scenes": {}}
    both: dict[str, list[Float[Array, "37 O"]]] = {"colour": [], "with_detections": []}
    for scene in scenes:
        curves = _curves(scene, len(scene.poses) // 2)
        result["scenes"][scene.name] = {
            name: (c - c.min(1, keepdims=True)).round(2).tolist() for name, c in curves.items()
        }
        for name, curve in curves.items():
            both[name].append(curve)
    for name, found in both.items():
        lowest = np.abs(np.array(OFFSETS_DEG)[np.array(found).argmin(-1)])  # (scenes, 37)
        result[name] = {
            "lowest_deg": round(float(lowest.mean()), 2),
            "near": round(float((lowest <= NEAR_DEG).mean()), 3),
            "lowest_deg_by_angle": dict(zip(DOFS, lowest.mean(0).round(1).tolist(), strict=True)),
        }
    return result


def _curves(scene: Scene, t: int) -> dict[str, Float[Array, "37 O"]]:
    """Energies (37, offsets) of colour alone and with detections at a frame."""
    scene.term.reset_background()
    colours = scene.term.set_images(scene.sequence.images(t), scene.poses[t])
    model, weight = scene.term.model, scene.term.weight
    detected = ImageSolver(model, ImageSolverConfig(lambda_colour=0.0))
    known = scene.observations(2.0)
    alone = np.zeros((DOF_COUNT, len(OFFSETS_DEG)))
    with_detections = alone.copy()
    for d in range(DOF_COUNT):
        for k, offset in enumerate(OFFSETS_DEG):
            pose = scene.poses[t].copy()
            pose[d] += np.deg2rad(offset)
            alone[d, k] = weight * model.evaluate(pose, colours).energy
            with_detections[d, k] = alone[d, k] + detected.energy(colours, pose, known, t)
    return {"colour": alone, "with_detections": with_detections}
