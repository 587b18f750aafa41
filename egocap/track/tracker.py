"""From detections in every view to a track of 37 joint angles."""

from __future__ import annotations

import logging
import time
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.proportions import Proportions
from egocap.body.skeleton import forward
from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.data.track import Track
from egocap.errors import InputError
from egocap.pose.config import TrackerConfig
from egocap.pose.observations import Observations, observe

if TYPE_CHECKING:
    from egocap.image_model.colour_term import ColourTerm
    from egocap.pose.kernel import Model
    from egocap.pose.motion_prior import Guide
    from egocap.track.camera_alignment import Alignment
    from egocap.track.colour_refinement import Images

log = logging.getLogger(__name__)


def track(
    detections: Detections,
    rig: Rig,
    proportions: Proportions,
    config: TrackerConfig = TrackerConfig(),  # noqa: B008 (frozen)
    images: Images | None = None,
) -> Track:
    """Track a person of known proportions from detections in all views of a rig.

    A causal pass predicts, solves and, where it is lost, searches every frame; then the chosen
    smoothing refines it. Frames without detections are carried by the motion around them.
    `energy` is each frame's own: detections, limits and pose prior. `images` gives the pictures of
    a frame by its number, for the colour term and for the paper's solvers, which have their own way
    (`paper_tracker`). Raises InputError when there are no frames, the
    views do not match the rig, the times do not increase, or colour has no images.
    """
    times = np.asarray(detections.times, float)
    if len(times) == 0:
        raise InputError("no frames to track")
    if not (np.isfinite(times).all() and (np.diff(times) > 0).all()):
        raise InputError("the detections' times do not increase from frame to frame")
    if (config.colour or config.solver != "fast") and images is None:
        raise InputError("colour without images", valid="images of every frame")
    if config.solver != "fast":
        return _track_as_paper(detections, rig, proportions, config, images)
    from threadpoolctl import threadpool_limits

    from egocap.pose import kernel
    from egocap.track.colour_refinement import ColourRefinement, learned_term
    from egocap.track.joint_occlusion import why_hidden
    from egocap.track.online_filter import term_energies
    from egocap.track.uncertainty import confidences, joint_covariances

    model = kernel.make_model(proportions, config)
    observations = observe(detections, rig, proportions, config)
    looks = images is not None and config.looks and bool(observations.weights.any())
    _compile(observations, proportions, model, config)
    if looks or config.colour:
        _compile_images(rig, proportions, config)

    # Matrices of 37 rows gain nothing from BLAS threads, which wait for each other when
    # the machine is busy.
    with threadpool_limits(1, user_api="blas"):
        clock = _Clock()
        observations = observe(detections, rig, proportions, config)
        clock.lap("observe")
        solution = _solve(observations, proportions, model, config, clock)
        covariances = _covariances(solution, model, config)
        clock.lap("covariance")
        if images is not None and covariances is not None and looks:
            term = learned_term(rig, proportions, config, images, solution.angles, covariances)
            clock.lap("palette")
            observations, solution = _looked_at(
                solution, observations, term, images, proportions, model, config, clock
            )
            if solution.estimated["denied"]:
                covariances = _covariances(solution, model, config)
                clock.lap("covariance")
        angles, colour = solution.angles, np.zeros(len(times))
        if images is not None and config.colour and covariances is not None:
            refinement = ColourRefinement(rig, proportions, config, images, angles, covariances)
            clock.lap("palette")
            seen = np.any(solution.taken.weights > 0.0, axis=1)
            angles, covariances, colour = refinement.refine(angles, covariances, seen)
            clock.lap("colour")
        joints = forward(proportions, angles)
        covariance = None
        if covariances is not None:
            covariance = joint_covariances(proportions, angles, covariances, config.model_error_m)
        clock.lap("joints")

    energies = term_energies(angles, solution.taken, model, config)
    energies[:, 3] = colour
    settings = {
        "tracker": asdict(config), "detections": detections.source, "rig": rig.name,
        "seconds": clock.seconds, "estimated": solution.estimated,
    }  # fmt: skip
    return Track(
        times=times,
        angles=angles,
        joints_head=joints,
        energy=energies[:, :2].sum(1),
        converged=solution.converged,
        detections_used=np.count_nonzero(observations.weights, axis=(1, 2)).astype(float),
        seconds_per_frame=sum(clock.seconds.values()) / len(times),
        config=settings,
        offsets=np.array(proportions.offsets),
        covariance=covariance,
        confidence=None if covariance is None else confidences(covariance),
        energies=energies,
        hidden=why_hidden(angles, detections, rig, proportions),
    )


def _track_as_paper(
    detections: Detections, rig: Rig, proportions: Proportions, config: TrackerConfig,
    images: Images | None,
) -> Track:  # fmt: skip
    from egocap.paper.config import PAPER_SOLVERS
    from egocap.paper.tracker import refuse_unused, track_as_paper

    assert images is not None
    refuse_unused(config)
    low_pass = 0.0 if config.smoothing == "none" else config.gaussian_frames
    solver = PAPER_SOLVERS[config.solver]
    found = track_as_paper(detections, rig, proportions, images, solver, low_pass)
    return replace(found, config=found.config | {"tracker": asdict(config)})


@dataclass
class _Clock:
    """Seconds spent by stage."""

    seconds: dict[str, float] = field(default_factory=dict)
    _since: float = field(default_factory=time.perf_counter)

    def lap(self, stage: str) -> None:
        """Enter the time since the last lap under a stage."""
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._since
        self._since = now


@dataclass(frozen=True, eq=False)
class _Solution:
    angles: Float[Array, "T 37"]
    converged: Bool[Array, "T"]
    taken: Observations  # the places chosen, as accurate as they proved
    telling: Observations  # the same, weighed by how much all frames together tell
    estimated: dict[str, object]  # what was found out besides, JSON-ready
    guide: Guide  # what the motion prior made of it


def _solve(
    observations: Observations, proportions: Proportions, model: Model, config: TrackerConfig,
    clock: _Clock,
) -> _Solution:  # fmt: skip
    from egocap.pose.motion_prior import NO_GUIDE
    from egocap.track import online_filter, smoother

    if config.smoothing == "interval":
        angles, _ = online_filter.track_both_ways(observations, model, config)
        clock.lap("frames")
        solution = _solve_together(angles, observations, proportions, model, config)
        clock.lap("smoothing")
        return solution
    angles, converged, taken = online_filter.follow(observations, model, config)
    clock.lap("frames")
    if config.smoothing == "gaussian":
        angles = smoother.smooth_gaussian(angles, config.gaussian_frames)
        clock.lap("smoothing")
    return _Solution(angles, converged, taken, taken, {}, NO_GUIDE)


def _solve_together(
    angles: Float[Array, "T 37"], observations: Observations, proportions: Proportions,
    model: Model, config: TrackerConfig,
) -> _Solution:  # fmt: skip
    """All frames at once; then once more with the places and accuracies that this brings out."""
    from egocap.pose.motion_prior import NO_GUIDE
    from egocap.track.association import can_choose, choose
    from egocap.track.multistart import restarted
    from egocap.track.noise_estimation import independent, measure_accuracy, recalibrated
    from egocap.track.smoother import smooth_interval

    choosing, taken = can_choose(observations, config), observations[:]
    if choosing:
        choose(angles, observations, taken, model, config)
    angles, converged = smooth_interval(angles, taken, model, config)
    changed = choosing and choose(angles, observations, taken, model, config) > 0
    estimated: dict[str, object] = {}
    if (config.synchronise or config.align_cameras) and taken.weights.shape[1] > 1:
        angles, taken, alignment = _align(angles, taken, proportions, model, config)
        estimated["lag_s"] = alignment.lag_s.round(5).tolist()
        estimated["rotation_deg"] = np.rad2deg(alignment.rotation).round(4).tolist()
        changed = True
    accuracy = None
    if config.recalibrate:
        accuracy = measure_accuracy(angles, taken, proportions)
        estimated["widening"] = accuracy.widening.round(3).tolist()
        estimated["correlation"] = round(accuracy.correlation, 3)
        taken, changed = recalibrated(taken, accuracy), changed or accuracy.matters
    if changed:
        angles, converged = smooth_interval(angles, taken, model, config)
    if config.restarts:
        angles, restarted_frames = restarted(angles, taken, model, config)
        estimated["restarted_frames"] = int(np.count_nonzero(restarted_frames))
        if restarted_frames.any():
            angles, converged = smooth_interval(angles, taken, model, config)
    guide = NO_GUIDE
    if config.lambda_motion > 0.0:
        angles, converged, guide = _guided(angles, taken, model, config)
    telling = taken if accuracy is None else independent(taken, accuracy)
    return _Solution(angles, converged, taken, telling, estimated, guide)


_LOOKS = 3


def _looked_at(
    solution: _Solution, observations: Observations, term: ColourTerm, images: Images,
    proportions: Proportions, model: Model, config: TrackerConfig, clock: _Clock,
) -> tuple[Observations, _Solution]:  # fmt: skip
    """The observations that the images do not deny, and the motion by them.

    Without them a limb may come to lie where the images deny it again: they are looked at anew.
    """
    from egocap.track.appearance_check import denied, without

    total = 0
    for _ in range(_LOOKS):
        labels = denied(term, images, observations, solution.angles)
        joints = forward(proportions, solution.angles)
        observations, dropped = without(observations, labels, joints)
        clock.lap("look")
        if not dropped:
            break
        total += dropped
        solution = _solve(observations, proportions, model, config, clock)
    solution.estimated["denied"] = total
    return observations, solution


_OPINIONS = 3


def _guided(
    angles: Float[Array, "T 37"], taken: Observations, model: Model, config: TrackerConfig
) -> tuple[Float[Array, "T 37"], Bool[Array, "T"], Guide]:
    """All frames at once with the motion prior; again where it is then of another opinion.

    It takes what detections tell as linear about the motion that it is given. What it makes of
    the motion that it led to is taken where that fits the detections better.
    """
    from egocap.pose.motion_prior import guide_of
    from egocap.track.multistart import moved, spliced
    from egocap.track.smoother import smooth_interval

    guide = guide_of(angles, taken, model, config)
    angles, converged = smooth_interval(angles, taken, model, config, guide)
    for _ in range(_OPINIONS if config.restarts else 0):
        second = guide_of(angles, taken, model, config)
        other, _ = smooth_interval(angles, taken, model, config, second)
        best = spliced(angles, other, taken, model, config)
        changed = moved(angles, best)
        if not changed.any():
            break
        guide = guide.replaced(second, changed)
        angles, converged = smooth_interval(best, taken, model, config, guide)
    return angles, converged, guide


_ALIGNMENTS = 4  # steps


def _align(
    angles: Float[Array, "T 37"], taken: Observations, proportions: Proportions, model: Model,
    config: TrackerConfig,
) -> tuple[Float[Array, "T 37"], Observations, Alignment]:  # fmt: skip
    """Views' lags and rotations and the motion, in turn; the observations without them."""
    from egocap.track.camera_alignment import Alignment, improve
    from egocap.track.smoother import smooth_interval

    alignment, seen = Alignment.none(taken.weights.shape[1]), taken
    for _ in range(_ALIGNMENTS):
        alignment = improve(alignment, angles, taken, proportions, model, config)
        seen = alignment.aligned(taken, forward(proportions, angles))
        angles, _ = smooth_interval(angles, seen, model, config)
    return angles, seen, alignment


def _covariances(
    solution: _Solution, model: Model, config: TrackerConfig
) -> Float[Array, "T 37 37"] | None:
    if not config.covariance:
        return None
    from egocap.track.uncertainty import causal_covariances, interval_covariances

    known = solution.angles, solution.telling, model, config
    if config.smoothing == "interval":
        return interval_covariances(*known, solution.guide)
    return causal_covariances(*known)


def _compile(
    observations: Observations, proportions: Proportions, model: Model, config: TrackerConfig
) -> None:
    """Compile the kernels, or load them from the cache, outside the clock."""
    started = time.perf_counter()
    solution = _solve(observations[:3], proportions, model, config, _Clock())
    _covariances(solution, model, config)
    log.debug("kernels ready after %.1f s", time.perf_counter() - started)


def _compile_images(rig: Rig, proportions: Proportions, config: TrackerConfig) -> None:
    """The same for the kernels that draw the body and ask images about it."""
    from egocap.body.gaussians import GaussianBody
    from egocap.body.skeleton import DOF_COUNT
    from egocap.image_model.image_kernel import Palettes
    from egocap.image_model.image_rays import image_rays
    from egocap.image_model.model import ImageModel

    model = ImageModel(GaussianBody.from_proportions(proportions), image_rays(rig, 16, 16))
    anywhere = np.zeros(DOF_COUNT)
    model.visibility(anywhere)
    if config.colour:
        alike = np.zeros((len(model.body.parts), 1), np.float32)
        nothing = Palettes(np.zeros(len(model.rays), np.int32), alike)
        model.evaluate(anywhere, nothing, curvature=True)
