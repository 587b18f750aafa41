"""Batch tracking: detections of a recording in every view in, a track of 37 joint angles out."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cache

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from threadpoolctl import threadpool_limits

from egocap.body.gaussians import GaussianBody
from egocap.body.labels import LABEL_INDEX
from egocap.body.proportions import Proportions
from egocap.body.skeleton import DOF_COUNT, forward
from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.data.head_pose import HeadPoses, in_world
from egocap.data.track import Track
from egocap.errors import InputError
from egocap.geometry import axis_angle, unit
from egocap.image_model.image_rays import image_rays
from egocap.image_model.kernel_arrays import Palettes
from egocap.image_model.model import ImageModel
from egocap.pose.config import TrackerConfig
from egocap.pose.kernel import make_model
from egocap.pose.observations import Observations, observe, tangent_basis
from egocap.track.appearance_check import find_rejected, remove_rejected
from egocap.track.batch_solver import BatchSolver, Solution
from egocap.track.colour_refinement import Images, learn_colour_term, refine_by_colour
from egocap.track.consistency import with_consistency
from egocap.track.joint_occlusion import occlusion_causes
from egocap.track.online_filter import term_energies
from egocap.track.stopwatch import WORLD_SOLUTIONS, OnFrames, StageProgress, Stopwatch
from egocap.track.uncertainty import joint_covariances
from egocap.track.world_solver import WorldSolver
from egocap.world.contact_network import contact_probabilities

log = logging.getLogger(__name__)

_MAX_APPEARANCE_CHECKS = 3
_SOLES = [LABEL_INDEX[f"{side}_{part}"] for side in ("left", "right") for part in ("ankle", "foot")]
"""Joints whose uncertainty is that of the points in `egocap.data.track.CONTACTS`."""


class Tracker:
    """Tracks a person of known proportions through a recording.

    The pipeline: observe, solve, check the appearance, refine by colour, joints and covariances.
    """

    def __init__(
        self, rig: Rig, proportions: Proportions,
        config: TrackerConfig = TrackerConfig(),  # noqa: B008 (frozen)
    ) -> None:  # fmt: skip
        self.rig, self.proportions, self.config = rig, proportions, config
        self._model = make_model(proportions, config)
        self._solver = BatchSolver(proportions, self._model, config)

    def track(
        self, detections: Detections, images: Images | None = None, heads: HeadPoses | None = None,
        on_frames: OnFrames = lambda count: None,
    ) -> Track:  # fmt: skip
        """Track from detections in all views of the rig, and from images if there are any.

        With `heads`, the head poses of the frames, the track is in the world, too, z up; contacts
        with the ground are then estimated, and planted feet keep their place; the
        motion prior uses them, too.

        `images` gives the RGB images of all views at a frame, for the appearance check and the
        colour term; another thread calls it, too, but never two at once. `on_frames` is called
        after every stage with the frames that its work is worth, which add up to all frames.
        `Track.energy` is each frame's own: detections, limits and pose prior. The time per frame
        leaves out compilation, which is `config["warm_up_s"]`. Raises InputError when there are no
        frames, the views do not match the rig, the times do not increase, or colour has no images.
        """
        require_increasing_times(detections)
        if self.config.colour and images is None:
            raise InputError("colour without images", valid="images of every frame")
        warm_up_s = self._warm_up(with_images=images is not None)
        progress = StageProgress(
            len(detections.times), self.config, on_frames,
            images=images is not None, world=heads is not None,
        )  # fmt: skip
        stopwatch = Stopwatch(progress.lap)
        # Matrices of 37 rows gain nothing from BLAS threads.
        with threadpool_limits(1, user_api="blas"):
            observations = observe(detections, self.rig, self.proportions, self.config)
            stopwatch.lap("observe")
            estimate = self._estimate(observations, heads, stopwatch)
            if images is not None and self.config.checks_appearance:
                estimate = self._check_appearance(estimate, images, heads, stopwatch)
            world = None
            if heads is not None and self.config.solves_world:
                estimate, world = self._solve_world(estimate, heads, stopwatch)
            if images is not None and self.config.colour:
                estimate = self._refine_by_colour(estimate, images, stopwatch)
            joints = forward(self.proportions, estimate.angles)
            covariance = self._joint_covariances(estimate)
            stopwatch.lap("joints")
        settings = {
            "solver": "fast", "tracker": asdict(self.config), "detections": detections.source,
            "rig": self.rig.name, "seconds": stopwatch.seconds, "warm_up_s": round(warm_up_s, 3),
            "estimated": estimate.solution.estimated,
        }  # fmt: skip
        energies = self._term_energies(estimate)
        track = Track(
            times=np.asarray(detections.times, float),
            angles=estimate.angles,
            joints_head=joints,
            energy=energies[:, :2].sum(1),
            converged=estimate.solution.converged,
            detections_used=np.count_nonzero(estimate.observations.weights, (1, 2)).astype(float),
            seconds_per_frame=sum(stopwatch.seconds.values()) / len(joints),
            config=settings,
            offsets=np.array(self.proportions.offsets),
            covariance=covariance,
            energies=energies,
            hidden=occlusion_causes(estimate.angles, detections, self.rig, self.proportions),
        )
        rig = turned_rig(self.rig, estimate.solution.estimated)
        track = with_consistency(track, detections, rig, self.proportions, self.config)
        progress.finish()
        if heads is None:
            return track
        return in_world(replace(track, contacts=world and world[1]), world[0] if world else heads)

    def _estimate(
        self, observations: Observations, heads: HeadPoses | None, stopwatch: Stopwatch
    ) -> _Estimate:
        solution = self._solver.solve(observations, stopwatch, heads)
        covariances = self._solver.covariances(solution) if self.config.covariance else None
        stopwatch.lap("covariance")
        colour = np.zeros(len(solution.angles))
        return _Estimate(observations, solution, solution.angles, covariances, colour)

    def _check_appearance(
        self, estimate: _Estimate, images: Images, heads: HeadPoses | None, stopwatch: Stopwatch
    ) -> _Estimate:
        """Remove detections that the images contradict, and solve without them.

        Repeated, as a limb may then move to another place that the images contradict.
        """
        observations, solution = estimate.observations, estimate.solution
        if not observations.weights.any():
            return estimate
        assert estimate.covariances is not None  # `checks_appearance` requires them
        term = learn_colour_term(
            self.rig, self.proportions, self.config, images, solution.angles,
            estimate.covariances, seeing(observations),
        )  # fmt: skip
        stopwatch.lap("palette")
        total = 0
        for _ in range(_MAX_APPEARANCE_CHECKS):
            labels = find_rejected(term, images, observations, solution.angles)
            joints = forward(self.proportions, solution.angles)
            observations, removed = remove_rejected(observations, labels, joints)
            stopwatch.lap("appearance check")
            if not removed:
                break
            total += removed
            solution = self._solver.solve(observations, stopwatch, heads)
        solution.estimated["rejected"] = total
        covariances = self._solver.covariances(solution) if total else estimate.covariances
        stopwatch.lap("covariance")
        return _Estimate(observations, solution, solution.angles, covariances, estimate.colour)

    def _solve_world(
        self, estimate: _Estimate, heads: HeadPoses, stopwatch: Stopwatch
    ) -> tuple[_Estimate, tuple[HeadPoses, Float[Array, "T 4"]]]:
        """The motion with the ground: also the head poses as corrected, and the contacts."""
        solution = estimate.solution
        joints = forward(self.proportions, solution.angles)
        covariance = self._joint_covariances(estimate)
        assert covariance is not None  # `solves_world` requires it
        sigma = np.sqrt(np.trace(covariance, axis1=2, axis2=3) / 3.0)
        up = heads.T_world_head[:, 2, :3]
        height = np.sqrt(np.einsum("ti,tjik,tk->tj", up, covariance[:, _SOLES], up))
        solver = WorldSolver(
            self.proportions, self._model, self.config, solution.chosen, solution.prediction, heads
        )
        seen = heads
        for _ in range(WORLD_SOLUTIONS):
            contacts = contact_probabilities(solution.chosen.times, joints, sigma, seen)
            world = solver.solve(solution.angles, contacts, height)
            joints = forward(self.proportions, world.angles)
            seen = replace(heads, T_world_head=world.T_world_head)
            stopwatch.lap("world")
        covariances = solver.covariances(
            world, solution.independent, solution.independent_prediction
        )
        stopwatch.lap("covariance")
        solution.estimated["ground"] = {
            "footholds": len(world.ground.gains), "level_m": round(world.ground.level, 4),
        }  # fmt: skip
        solution = replace(solution, angles=world.angles, converged=world.converged)
        estimate = replace(
            estimate, solution=solution, angles=world.angles, covariances=covariances
        )
        return estimate, (seen, world.contacts)

    def _refine_by_colour(
        self, estimate: _Estimate, images: Images, stopwatch: Stopwatch
    ) -> _Estimate:
        angles, covariances = estimate.angles, estimate.covariances
        assert covariances is not None  # the settings require them
        term = learn_colour_term(
            self.rig, self.proportions, self.config, images, angles, covariances,
            seeing(estimate.observations),
        )  # fmt: skip
        stopwatch.lap("palette")
        seen = np.any(estimate.solution.chosen.weights > 0.0, axis=1)
        angles, covariances, colour = refine_by_colour(angles, covariances, seen, term, images)
        stopwatch.lap("colour")
        return replace(estimate, angles=angles, covariances=covariances, colour=colour)

    def _joint_covariances(self, estimate: _Estimate) -> Float[Array, "T 18 3 3"] | None:
        if estimate.covariances is None:
            return None
        return joint_covariances(
            self.proportions, estimate.angles, estimate.covariances, self.config.model_error_m
        )

    def _term_energies(self, estimate: _Estimate) -> Float[Array, "T 4"]:
        energies = term_energies(
            estimate.angles, estimate.solution.chosen, self._model, self.config
        )
        energies[:, 3] = estimate.colour
        return energies

    def _warm_up(self, *, with_images: bool) -> float:
        """Compile the kernels, or load them from numba's cache; the seconds that took."""
        started = time.perf_counter()
        _warm_up_solver()
        if with_images and (self.config.checks_appearance or self.config.colour):
            _warm_up_images(self.rig, self.proportions, self.config.colour)
        spent = time.perf_counter() - started
        log.debug("kernels ready after %.1f s", spent)
        return spent


@dataclass(frozen=True, eq=False)
class _Estimate:
    """What is known of all frames after a stage of the pipeline."""

    observations: Observations  # those that were not rejected
    solution: Solution
    angles: Float[Array, "T 37"]
    covariances: Float[Array, "T 37 37"] | None
    colour: Float[Array, "T"]  # energy


def turned_rig(rig: Rig, estimated: Mapping[str, object]) -> Rig:
    """The rig with the rotations of its views that the solver estimated, if it did."""
    turns = estimated.get("rotation_deg")
    if not isinstance(turns, list):
        return rig
    mounts = []
    for mount, turn in zip(rig.mounts, np.deg2rad(turns), strict=True):
        T = mount.T_head_camera.copy()
        T[:3, :3] = axis_angle(unit(turn), float(np.linalg.norm(turn))) @ T[:3, :3]
        mounts.append(replace(mount, T_head_camera=T))
    return replace(rig, mounts=tuple(mounts))


def seeing(observations: Observations) -> Bool[Array, "T"]:
    """Frames in which the most views detected something: all, unless one never did."""
    views = (observations.weights > 0.0).any(-1).sum(-1)
    return np.asarray(views == views.max())


def require_increasing_times(detections: Detections) -> None:
    """Raise InputError unless there are frames, each later than the last."""
    times = np.asarray(detections.times, float)
    if len(times) == 0:
        raise InputError("no frames to track")
    if not (np.isfinite(times).all() and (np.diff(times) > 0).all()):
        raise InputError("the detections' times do not increase from frame to frame")


@cache
def _warm_up_solver() -> None:
    """Solve three frames of a person at rest, once a process."""
    config, person = TrackerConfig(), Proportions.from_lengths(1.75)
    centres = np.array([[0.3, 0.1, 0.0], [0.3, -0.1, 0.0]])
    rays = np.tile(unit(person.rest_joints - centres[:, None]), (3, 1, 1, 1))
    observations = Observations(
        np.arange(3) / 30.0, centres, rays, 100.0 * tangent_basis(rays), np.ones(rays.shape[:3])
    )
    solver = BatchSolver(person, make_model(person, config), config)
    solver.covariances(solver.solve(observations, Stopwatch()))


def _warm_up_images(rig: Rig, proportions: Proportions, colour: bool) -> None:
    """Evaluate a tiny image of the rest pose."""
    model = ImageModel(GaussianBody.from_proportions(proportions), image_rays(rig, 16, 16))
    rest = np.zeros(DOF_COUNT)
    model.visibility(rest)
    if colour:
        alike = np.zeros((len(model.body.parts), 1), np.float32)
        palettes = Palettes(np.zeros(len(model.rays), np.int32), alike)
        model.evaluate(rest, palettes, curvature=True)
