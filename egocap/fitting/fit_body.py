"""A person's bone lengths and their uncertainty from detections over many frames.

Poses of the frames that differ most and the components of one body are found together: bundle
adjustment (`bundle_adjustment`). The energy is the tracker's own, a frame at a time, plus the prior
over bodies.

Source: EgoCap 2016, section 4.1 (personalisation from few poses).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from egocap.body.proportions import Proportions
from egocap.body.skeleton import POINTS, SPREAD
from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.errors import InputError
from egocap.fitting.body_prior import BodyPrior, length_spread, to_proportions
from egocap.fitting.bundle_adjustment import (
    FitProblem,
    information,
    linearised,
    select_frames,
    solve,
    without_bias,
)
from egocap.fitting.config import FitConfig
from egocap.pose.config import TrackerConfig
from egocap.pose.observations import observe

BODY_PASSES = 2
"""Times that the work on all frames is told: their track, and the fit, which takes as long."""
SYSTEMATIC = 0.025
"""Standard deviation of a bone's length that more frames do not reduce, as a part of it: detectors
mark what covers the joints. Source: fits of 140 simulated people on five rigs with the shipped
detector: the bones' errors are 0.98 to 1.18 times the stated ones, by rig."""
WELL = 0.035
"""Relative standard deviation up to which a bone counts as well determined: the noise of the frames
adds less than `SYSTEMATIC`."""
LEARNED_SHARE = 0.8
"""A bone counts as observed when its standard deviation by noise is below this fraction of that
among people of one stature: other bones determine the stature only."""


@dataclass(frozen=True, eq=False)
class BodyFit:
    """A person's proportions and their uncertainty. Not converging is no error."""

    proportions: Proportions
    noise_std: Float[Array, "22"]  # of the length of the bone to each point, metres: by noise alone
    prior_std: Float[Array, "22"]  # the same by the prior
    usual_std: Float[Array, "22"]  # the same among people of one stature
    components: Float[Array, "K"]  # `body_prior.COMPONENTS`, metres
    covariance: Float[Array, "K K"]
    frames: Int[Array, "F"]  # which took part
    angles: Float[Array, "F 37"]  # their poses, radians
    detections: int  # how many took part
    seen: Int[Array, "18"]  # how many of each label
    residual: float  # root mean square, in the detections' standard deviations
    converged: bool
    config: dict[str, object] = field(default_factory=dict)

    @property
    def std(self) -> Float[Array, "22"]:
        """Standard deviation of the length of the bone to each point, metres."""
        lengths = np.linalg.norm(self.proportions.offsets, axis=1)
        return np.minimum(np.hypot(self.noise_std, SYSTEMATIC * lengths), self.prior_std)

    @property
    def relative_std(self) -> Float[Array, "22"]:
        """Standard deviation of every bone relative to its length; 0 for bones without length."""
        lengths = np.linalg.norm(self.proportions.offsets, axis=1)
        return np.where(lengths > 1e-6, self.std / np.maximum(lengths, 1e-6), 0.0)

    def spread(self, count: int) -> list[tuple[int, int]]:
        """Row in `angles` and number of the frame, for so many frames spread over those used."""
        rows = np.unique(np.linspace(0, len(self.frames) - 1, count).round().astype(int))
        return [(int(row), int(self.frames[row])) for row in rows]

    @property
    def well_determined(self) -> Bool[Array, "22"]:
        """Bones that the detections, not the prior, determine well."""
        return (self.relative_std <= WELL) & self.learned

    @property
    def learned(self) -> Bool[Array, "22"]:
        """Bones that the detections determine better than the stature does."""
        return self.noise_std < LEARNED_SHARE * self.usual_std

    def report(self) -> dict[str, dict[str, float | str]]:
        """Length in metres, standard deviation in %, and their source, by bone."""
        lengths = self.proportions.bone_lengths
        lines: dict[str, dict[str, float | str]] = {}
        for i, name in enumerate(POINTS):
            if lengths[name] > 1e-6:
                seen = "well" if self.well_determined[i] else "badly"
                verdict = seen if self.learned[i] else "prior"
                lines[name] = {
                    "length_m": round(lengths[name], 4),
                    "std_percent": round(100.0 * float(self.relative_std[i]), 2),
                    "determined": verdict,
                }
        return lines


def fit_body(
    detections: Detections,
    rig: Rig,
    height: float | None = None,
    config: FitConfig = FitConfig(),  # noqa: B008 (frozen)
    tracker: TrackerConfig = TrackerConfig(),  # noqa: B008 (frozen)
    on_frames: Callable[[int], None] = lambda count: None,
) -> BodyFit:
    """The proportions of the person whom detections in all views of a rig show.

    `height` in metres, where it is known, is a strong prior. Bones without detections stay at the
    prior, as `report` states. `on_frames` is called with frames worked on, `BODY_PASSES` times all
    of them. Raises InputError for a height that no adult has, when there are no detections at all,
    and as `tracker.track`.
    """
    from egocap.track.tracker import Tracker

    prior = BodyPrior.for_height(height)
    average = to_proportions(prior.mean)
    followed = Tracker(rig, average, tracker).track(detections, on_frames=on_frames)
    observations = observe(detections, rig, average, tracker)
    used = np.count_nonzero(observations.weights, axis=(1, 2))
    if not used.any():
        raise InputError("no detection to fit a body to")
    frames = choose_frames(followed.angles, used, config.frames)
    of_frames = select_frames(observations, frames)
    problem = FitProblem(of_frames, prior, tracker)
    poses, components, converged = solve(problem, followed.angles[frames], prior.mean, config)
    on_frames(len(detections.times) // 2)
    poses, components = without_bias(problem, poses, components)
    fit = _finished(problem, prior, poses, components, converged, frames)
    on_frames(-(-len(detections.times) // 2))
    return fit


def first_seconds(detections: Detections, seconds: float) -> Detections:
    """The first seconds of some detections. Raises InputError for no time at all."""
    if not seconds > 0.0:
        raise InputError(f"the first {seconds} s", valid="above 0")
    times = np.asarray(detections.times, float)
    count = int(np.count_nonzero(times <= times[:1] + seconds)) if len(times) else 0
    return detections[:count]


def choose_frames(
    angles: Float[Array, "T 37"], used: Int[Array, "T"], count: int
) -> Int[Array, "F"]:
    """Frames that differ most from each other, among those with enough detections, if any.

    Farthest-point selection: similar poses are redundant.
    """
    if not used.any():
        return np.array([], int)
    able = np.flatnonzero(used >= 0.5 * np.median(used[used > 0]))
    if len(able) <= count:
        return able
    scaled = angles[able] / SPREAD
    picked = [int(np.argmax(used[able]))]
    distance = np.full(len(able), np.inf)
    while len(picked) < count:
        distance = np.minimum(distance, ((scaled - scaled[picked[-1]]) ** 2).sum(1))
        picked.append(int(np.argmax(distance)))
    return able[np.sort(picked)]


def _finished(
    problem: FitProblem,
    prior: BodyPrior,
    poses: Float[Array, "T 37"],
    components: Float[Array, "K"],
    converged: bool,
    frames: Int[Array, "T"],
) -> BodyFit:
    system = linearised(problem, poses, components)
    weights = problem.observations.weights
    used = weights > 0.0
    # Detections worse than stated raise the covariance; better ones do not lower it.
    typical = float(np.median(system.squared[used]) / (2.0 * np.log(2.0)))
    covariance = np.linalg.inv(information(system)) * max(1.0, typical)
    return BodyFit(
        proportions=to_proportions(components),
        noise_std=length_spread(components, covariance),
        prior_std=length_spread(components, prior.covariance),
        usual_std=length_spread(components, prior.individual),
        components=components,
        covariance=covariance,
        frames=frames,
        angles=poses,
        detections=int(used.sum()),
        seen=used.sum((0, 1)),
        residual=float(np.sqrt(system.squared[used].mean() / 2.0)),
        converged=converged,
    )
