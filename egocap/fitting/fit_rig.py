"""Where a rig sits on a head, together with the body, from detections over some seconds.

Bundle adjustment as in `fit_body`, with the rigid motion of the rig against the skull as six more
shared parameters (`mount`). Position is determined by the neck turning about the skull base and by
the population's neck; rotation by how the wearer holds the head alone (`stance`). N stances that
are met within 1.9 degrees of yaw and pitch and 1.0 of roll leave a standard deviation of
2.9 / sqrt(N) degrees, whatever the detections.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.errors import InputError
from egocap.fitting.body_prior import BodyPrior, to_proportions
from egocap.fitting.bundle_adjustment import (
    information,
    linearised,
    select_frames,
    solve,
)
from egocap.fitting.config import FitConfig
from egocap.fitting.fit_body import BODY_PASSES, BodyFit, choose_frames, fit_body
from egocap.fitting.mount import PARAMETERS, MountPrior, MountProblem
from egocap.fitting.stance import neutral_weights
from egocap.geometry import exponential, rigid
from egocap.pose.config import TrackerConfig
from egocap.pose.observations import observe

RIG_PASSES = 2 + BODY_PASSES
"""Times that the work on all frames is told: their track, the fit of the rig, that of the body."""
SYSTEMATIC = np.repeat([np.deg2rad(0.5), 0.002], 3)
"""Standard deviations that more frames do not reduce: habits of stance, marks on the skin."""
LASTING = 10
"""Detections of a label that count as one: much of their error is the same in every frame of a
person and does not average out. Chosen on ten rendered people, of the seeds 201 to 210."""
OBSERVED = 0.5
"""Fraction of its prior standard deviation below which a parameter counts as observed."""
GOOD_DEG = 1.0
"""Standard deviation of the rotation, all axes together, above which more stances are asked for."""
LONGER = 3
"""Times as many stances as were seen, for which the standard deviation is predicted."""
MOVES = (
    "2 s: stand upright, arms hanging, and look at a mark on the horizon straight ahead (gives the "
    "rotation); do so again for half a second after each of the following moves, since no one "
    "meets it exactly",
    "4 s: nod slowly, chin to chest; later up (forward and up)",
    "4 s: turn the head slowly, to the left; later to the right (forward and left)",
    "4 s: tilt the head to either shoulder (left and up)",
    "3 s: both arms forward and sideways (body)",
    "3 s or more: squats, looking ahead (body)",
)
"""What to do before the cameras, and what it determines."""


class MountError(NamedTuple):
    """How far a rig file may be off: standard deviations."""

    position_m: float = 0.03
    rotation_deg: float = 10.0


@dataclass(frozen=True, eq=False)
class RigFit:
    """A rig on a head, and the body, with their uncertainty. Not converging is no error."""

    rig: Rig  # as fitted
    body: BodyFit
    shift: Float[Array, "6"]  # rotation vector [rad], translation [m]: given to fitted rig, head
    covariance: Float[Array, "6 6"]
    prior: Float[Array, "6 6"]  # covariance before
    neutral: int  # frames of the neutral stances that took part
    stances: int  # how often the neutral stance was taken
    frames: int
    residual: float  # root mean square, in the detections' standard deviations
    converged: bool

    @property
    def std(self) -> Float[Array, "6"]:
        """Standard deviations: roll, pitch, yaw [rad], forward, left, up [m]."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def observed(self) -> Array:
        """Which parameters the footage determines, not the prior."""
        return self.std < OBSERVED * np.sqrt(np.diag(self.prior))

    def report(self) -> dict[str, dict[str, float | bool]]:
        """Shift, its standard deviation (degrees and millimetres) and whether it was observed."""
        scale = np.repeat([np.rad2deg(1.0), 1e3], 3)
        lines = zip(self.shift * scale, self.std * scale, self.observed, strict=True)
        return {
            name: {"shift": round(float(a), 2), "std": round(float(b), 2), "observed": bool(seen)}
            for name, (a, b, seen) in zip(PARAMETERS, lines, strict=True)
        }

    def notes(self) -> list[str]:
        """What is not observable, and what to record instead."""
        found = []
        if not self.neutral:
            found.append("rotation: no neutral stance; the neck's angles and the rig's rotation "
                         f"have the same effect on the images. Record {MOVES[0]}")  # fmt: skip
        elif (turn := _degrees(self.covariance)) > GOOD_DEG:
            own = (self.covariance - np.diag(SYSTEMATIC**2)) / LONGER + np.diag(SYSTEMATIC**2)
            found.append(
                f"rotation: standard deviation {turn:.1f} degrees, all axes together, from "
                f"{self.stances} neutral stances: a wearer meets each within 2 degrees, and "
                f"nothing else shows it. {LONGER * self.stances} stances leave "
                f"{_degrees(own):.1f}: repeat the moves, with longer --seconds"
            )
        blind = [n for n, seen in zip(PARAMETERS[3:], self.observed[3:], strict=True) if not seen]
        if blind:
            found.append(f"{', '.join(blind)}: the head hardly moved against the shoulders. "
                         f"Record {'; '.join(MOVES[1:4])}")  # fmt: skip
        return found


def fit_rig(
    detections: Detections,
    rig: Rig,
    height: float | None = None,
    neutral: tuple[float, float] | None = (0.0, 0.5),
    error: MountError = MountError(),  # noqa: B008 (immutable)
    config: FitConfig = FitConfig(),  # noqa: B008 (frozen)
    tracker: TrackerConfig = TrackerConfig(),  # noqa: B008 (frozen)
    on_frames: Callable[[int], None] = lambda count: None,
) -> RigFit:
    """The pose of a rig on the head of the person whom its detections show, and the person's body.

    `rig` is the rig as built or guessed, right within `error`; `height` in metres. In the seconds
    `neutral`, first to last, the person stands upright and looks at the horizon; None: never. Later
    returns to that stance are found and count as further, independent ones. `on_frames` is called
    with frames worked on, `RIG_PASSES` times all of them. Raises InputError for impossible values,
    without detections, and as `tracker.track`.
    """
    from egocap.track.tracker import Tracker

    if not (0.0 < error[0] <= 2.0 and 0.0 < error[1] <= 180.0):
        raise InputError(f"a mount error of {error[0]} m, {error[1]} degrees",
                         valid="above 0, to 2 m and 180 degrees")  # fmt: skip
    body = BodyPrior.for_height(height)
    average = to_proportions(body.mean)
    followed = Tracker(rig, average, tracker).track(detections, on_frames=on_frames)
    observations = observe(detections, rig, average, tracker).weighted(1.0 / LASTING)
    used = np.count_nonzero(observations.weights, axis=(1, 2))
    if not used.any():
        raise InputError("no detection to fit a rig to")
    weights = neutral_weights(observations.times, used, followed.joints_head, neutral)
    chosen = choose_frames(followed.angles, used, config.frames)
    frames = np.union1d(chosen, np.flatnonzero(weights.any(1)))
    spread = (float(np.deg2rad(error.rotation_deg)), error.position_m)
    prior = MountPrior.around(body.mean, body.covariance, *spread)
    problem = MountProblem(select_frames(observations, frames), prior, tracker, weights[frames])
    poses, shared, converged = solve(problem, followed.angles[frames], prior.mean, config)
    on_frames(len(detections.times))
    fitted = moved_rig(rig, shared[-6:])
    person = fit_body(detections, fitted, height, config, tracker, on_frames)
    return _finished(problem, poses, shared, fitted, person, converged)


def moved_rig(rig: Rig, shift: Float[Array, "6"]) -> Rig:
    """The rig after a rotation [rad] and translation [m] of the head frame."""
    move = rigid(exponential(shift[:3]), shift[3:])
    mounts = (replace(m, T_head_camera=move @ m.T_head_camera) for m in rig.mounts)
    return replace(rig, mounts=tuple(mounts))


def _degrees(covariance: Float[Array, "6 6"]) -> float:
    """Standard deviation of the size of the rotation."""
    return float(np.rad2deg(np.sqrt(np.trace(covariance[:3, :3]))))


def _finished(
    problem: MountProblem, poses: Float[Array, "F 37"], shared: Float[Array, "K"], rig: Rig,
    body: BodyFit, converged: bool,
) -> RigFit:  # fmt: skip
    system = linearised(problem, poses, shared)
    seen = problem.observations.weights > 0.0
    # Detections worse than stated raise the covariance; better ones do not lower it.
    typical = float(np.median(system.squared[seen]) / (2.0 * np.log(2.0)))
    covariance = np.linalg.inv(information(system))[-6:, -6:] * max(1.0, typical)
    return RigFit(
        rig=rig,
        body=body,
        shift=shared[-6:],
        covariance=covariance + np.diag(SYSTEMATIC**2),
        prior=problem.prior.covariance[-6:, -6:],
        neutral=int(np.count_nonzero(problem.neutral[:, 0])),
        stances=int(np.rint(problem.neutral[:, 0].sum())),
        frames=len(poses),
        residual=float(np.sqrt(system.squared[seen].mean() / 2.0)),
        converged=converged,
    )
