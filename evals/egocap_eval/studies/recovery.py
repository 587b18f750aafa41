"""Measure recovery: from a wrong pose, with detections or colours alone, and after darkness.

Every trial starts in a wrong pose at a frame of a sequence and has one second to recover. The
tracker with detections is misled for a few frames by detections of the wrong pose; the colour-only
tracker starts in the wrong pose. In the dark there are no detections for two seconds.
Source: EgoCap paper, section 5.5 ("disabling the detection term removes the ability to recover").
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

import egocap
from egocap.body.labels import EVALUATED
from egocap.body.skeleton import LIMITS, forward
from egocap.data.detections import Detections
from egocap.data.sequence import Sequence as Footage
from egocap.errors import InputError
from egocap.pose.config import TrackerConfig
from egocap.pose.pose_prior import load_posture

LOST_MM, WORST_MM = 150.0, 400.0
"""Minimum and maximum of the wrong pose's mean joint error."""
FOUND_MM = 75.0
"""A trial is recovered when the mean error over its last frames is below this."""
MISLED_FRAMES, SCORED_FRAMES = 3, 5
"""Frames of wrong detections before a trial; last frames of a trial, which are scored."""
COLOUR_SIZE, COLOUR_WEIGHT = 64, 0.03
PALETTE_FRAMES = 5
DARK_S, LIT_S = 2.0, 0.4
"""Seconds without detections, and after them, to the end of a recording."""
USUAL_FACTOR = 1.5
"""Recovered: the error is below this many times the one without the darkness."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A wrong pose at a frame, and its mean error there."""

    frame: int
    angles: Float[Array, "37"]
    error_mm: float


def draw_trials(
    footage: Footage, count: int, frames: int, rng: np.random.Generator
) -> Iterator[Trial]:
    """Wrong poses, drawn from the pose prior, at frames spread over a sequence.

    `MISLED_FRAMES` precede each frame and `frames` follow it. Raises InputError for a sequence
    that is too short.
    """
    if len(footage) < MISLED_FRAMES + frames:
        raise InputError(f"{len(footage)} frames of {footage.manifest.name}",
                         valid=f"{MISLED_FRAMES + frames} or more to recover in")  # fmt: skip
    posture = load_posture()
    spread = np.linalg.cholesky(np.linalg.inv(posture.precision))
    for frame in np.linspace(MISLED_FRAMES, len(footage) - frames, count).astype(int):
        true = footage.truth.joints_head[frame]
        while True:
            drawn = posture.mean + spread @ rng.normal(size=len(spread))
            angles = np.clip(drawn, *LIMITS.T)
            error = _error_mm(forward(footage.body, angles), true)
            if LOST_MM <= error <= WORST_MM:
                break
        yield Trial(int(frame), angles, error)


def by_detections(footage: Footage, detections: Detections, trial: Trial, frames: int) -> float:
    """Final error of a trial, mm: the online tracker misled, then given the true detections."""
    tracker = egocap.OnlineTracker(footage.rig, footage.body, TrackerConfig(smoothing="none"))
    start = trial.frame
    before, after = range(start - MISLED_FRAMES, start), range(start, start + frames)
    misled = [_detections_at(detections[t : t + 1], footage, trial.angles) for t in before]
    true = [detections[t : t + 1] for t in after]
    joints = [pose.joints_head for found in [*misled, *true] for pose in tracker.step(found)]
    return _end_error(np.array(joints[MISLED_FRAMES:]), footage, start)


def by_colours(footage: Footage, follow: ColourFollower, trial: Trial, frames: int) -> float:
    """Final error of a trial, mm, of the tracker that uses colours alone."""
    joints = follow.joints(range(trial.frame, trial.frame + frames), trial.angles)
    return _end_error(joints, footage, trial.frame)


class ColourFollower:
    """Track a person by colours learned at known poses of the sequence, without detections."""

    def __init__(self, footage: Footage, angles: Float[Array, "T 37"]) -> None:
        from egocap.image_model.colour_solver import ImageSolver, ImageSolverConfig
        from egocap.image_model.colour_term import ColourTerm, ColourTermConfig

        self._footage = footage
        chosen = np.linspace(0, len(footage) - 1, PALETTE_FRAMES).astype(int)
        frames = [(footage.images(t), angles[t]) for t in chosen]
        config = ColourTermConfig(COLOUR_SIZE, weight=COLOUR_WEIGHT)
        self._term = ColourTerm.learned(
            footage.rig, footage.body, frames, config, adapt_illumination=False
        )
        self._solver = ImageSolver(
            self._term.model, ImageSolverConfig(lambda_colour=COLOUR_WEIGHT),
            TrackerConfig(zeta=0.7, velocity_sigma=8.0),
        )  # fmt: skip

    def joints(self, frames: Sequence[int], start: Float[Array, "37"]) -> Float[Array, "T 18 3"]:
        """Joints in the head frame at successive frames, from a pose at the first."""
        from egocap.image_model.colour_solver import track_colours

        self._term.reset_background()
        seen = (self._term.set_images(self._footage.images(t), start if t == frames[0] else None)
                for t in frames)  # fmt: skip
        fps = self._footage.manifest.fps
        found = track_colours(self._solver, seen, start, fps)
        return forward(self._footage.body, np.array([s.angles for s in found]))


def after_darkness(footage: Footage, detections: Detections) -> dict[str, float | None]:
    """Seconds until the online tracker has recovered from `DARK_S` without detections.

    From the first frame with detections to the first one from which on the error stays below
    `USUAL_FACTOR` times that of the same tracker without the darkness: its mean over these frames,
    or the frame's own where that is more; `LIT_S` if it never does. Also both mean errors there and
    the last one in the dark, mm. All are None for recordings that are too short.
    """
    times = detections.times
    lit = times > times[-1] - LIT_S
    dark = ~lit & (times > times[-1] - LIT_S - DARK_S)
    if not (~lit & ~dark).any():
        return dict.fromkeys(("recovery_s", "after_mm", "usual_mm", "dark_mm"))
    blind = replace(detections, valid=detections.valid & ~dark[:, None, None])
    usual, found = (_live_errors(footage, given) for given in (detections, blind))
    limit = USUAL_FACTOR * np.maximum(usual[lit], usual[lit].mean())
    off = np.flatnonzero(found[lit] > limit)
    back = 0 if len(off) == 0 else int(off[-1]) + 1
    spent = np.append(times[lit] - times[lit][0], LIT_S)[back]
    return {"recovery_s": float(spent), "after_mm": float(found[lit].mean()),
            "usual_mm": float(usual[lit].mean()), "dark_mm": float(found[dark][-1])}  # fmt: skip


def _live_errors(footage: Footage, detections: Detections) -> Float[Array, "T"]:
    """Mean error of every frame by the online tracker, mm."""
    tracker = egocap.OnlineTracker(footage.rig, footage.body)
    joints = np.array([pose.joints_head for t in range(len(detections.times))
                       for pose in tracker.step(detections[t : t + 1])])  # fmt: skip
    true = footage.truth.joints_head[: len(joints)]
    return np.array([_error_mm(*pair) for pair in zip(joints, true, strict=True)])


def _detections_at(found: Detections, footage: Footage, angles: Float[Array, "37"]) -> Detections:
    """One frame's detections replaced by the projected joints of a pose, with confidence 1."""
    pixels, valid = footage.rig.project(forward(footage.body, angles))  # (V, 18, 2)
    certain = np.ones(found.valid.shape)
    return replace(found, points=pixels[None], valid=valid[None], confidence=certain,
                   sigma=2.0 * certain, modes=None, mode_weights=None)  # fmt: skip


def _end_error(joints: Float[Array, "T 18 3"], footage: Footage, start: int) -> float:
    true = footage.truth.joints_head[start : start + len(joints)]
    return _error_mm(joints[-SCORED_FRAMES:], true[-SCORED_FRAMES:])


def _error_mm(joints: Float[Array, "*T 18 3"], true: Float[Array, "*T 18 3"]) -> float:
    counted = list(EVALUATED)
    off = np.linalg.norm(joints[..., counted, :] - true[..., counted, :], axis=-1)
    return 1e3 * float(off.mean())
