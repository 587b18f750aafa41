"""Minimise the colour energy with the priors by damped Gauss-Newton.

The energies of `egocap.pose.energy` are negative log-posteriors; the colour energy joins them
times `ImageSolverConfig.lambda_colour`, as in equation 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray as Array

from egocap.body.skeleton import DOF_COUNT, DOFS, SPREAD
from egocap.errors import InputError
from egocap.image_model.colour_term import movable_angles
from egocap.image_model.kernel_arrays import Palettes
from egocap.image_model.model import Evaluation, ImageModel
from egocap.pose.config import TrackerConfig
from egocap.pose.energy import predict
from egocap.pose.kernel import detections, make_model, priors, smoothness
from egocap.pose.observations import Observations
from egocap.pose.solver import cholesky_solve

UPPER_BODY: Bool[Array, "37"] = np.array([not n.split("_")[1].startswith(("hip", "knee", "ankle"))
                                          for n in DOFS])  # fmt: skip
"""Angles of spine, neck and arms: what the paper's live test tracks."""


Term = Callable[[Float[Array, "37"], Float[Array, "37 37"], Float[Array, "37"]], float]
"""A term's energy at a pose; adds its Gauss-Newton matrix (lower triangle) and its gradient."""


@dataclass(frozen=True)
class ImageSolverConfig:
    """Settings of the colour-based solver."""

    lambda_colour: float = 0.02
    """Weight of one pixel that fits wholly or not at all. Errors of neighbouring pixels are
    correlated, so that each counts far less than an independent measurement."""
    reference_rays: int = 28_000
    """Number of rays at which `lambda_colour` holds; with fewer, each weighs more."""
    iterations: int = 8
    """Gauss-Newton steps a frame."""
    tolerance: float = 1e-3
    """Relative decrease of a frame's first energy below which it has converged."""

    def __post_init__(self) -> None:
        for name in ("reference_rays", "iterations"):
            if not 0 < getattr(self, name) < float("inf"):
                raise InputError(f"{name} = {getattr(self, name)}", valid="above 0")
        for name in ("lambda_colour", "tolerance"):
            if not 0 <= getattr(self, name) < float("inf"):
                raise InputError(f"{name} = {getattr(self, name)}", valid="a number from 0")


@dataclass(frozen=True, eq=False)
class Solution:
    """A minimised pose. Not converging is no error."""

    angles: Float[Array, "37"]
    energy: float
    converged: bool
    steps: int
    colour: Evaluation | None = None  # there, unweighted, where the model has seen no pose since


class ImageSolver:
    """Finds poses that explain images, from colours alone.

    `free` are the angles that may move; the others stay at their start. Detections of the same
    frames join the colours when `observations` are given to `solve`.
    """

    def __init__(
        self,
        model: ImageModel,
        config: ImageSolverConfig = ImageSolverConfig(),
        priors_config: TrackerConfig = TrackerConfig(),  # noqa: B008 (frozen)
        free: Bool[Array, "37"] | None = None,
    ) -> None:
        self.model, self.config, self.priors_config = model, config, priors_config
        self.free = np.ones(DOF_COUNT, bool) if free is None else np.asarray(free, bool)
        self._skeleton = make_model(model.body.proportions, priors_config)
        self._weight = config.lambda_colour * config.reference_rays / len(model.rays)

    def solve(
        self,
        colours: Float32[Array, "P 3"] | Palettes,
        start: Float[Array, "37"],
        predicted: Float[Array, "37"] | None = None,
        scatter: Float[Array, "37"] | None = None,
        observations: Observations | None = None,
        frame: int = 0,
        term: Term | None = None,
    ) -> Solution:
        """Damped Gauss-Newton from a start.

        A prediction with its standard deviations and the detections of one frame are added when
        given; with detections, the colours move detected limbs only (`colour_term.movable_angles`).
        `term` is a further term of the energy.
        """
        angles, damping = np.array(start, float), 1e-3
        seen = _detected(observations, frame)
        energy, gradient, H, colour = self._total(colours, angles, predicted, scatter, seen, term)
        first, steps, done = abs(energy), 0, False
        while steps < self.config.iterations and not done:
            trial = angles + self._step(gradient, H, damping)
            new, new_gradient, new_H, there = self._total(
                colours, trial, predicted, scatter, seen, term
            )
            steps += 1
            if new < energy:
                done = energy - new < self.config.tolerance * first
                angles, energy, gradient, H, colour = trial, new, new_gradient, new_H, there
                damping = max(0.2 * damping, 1e-6)
            else:
                done, colour = damping > 1e4, None
                damping *= 10.0
        return Solution(angles, energy, done, steps, colour)

    def energy(
        self,
        colours: Float32[Array, "P 3"] | Palettes,
        angles: Float[Array, "37"],
        observations: Observations | None = None,
        frame: int = 0,
    ) -> float:
        """Energy that `solve` minimises, at a pose."""
        colour, seen = self.model.evaluate(angles, colours), _detected(observations, frame)
        energy, gradient, H = self._with_priors(colour, angles, None, None)
        if seen is None:
            return energy
        scale = float(self.priors_config.robust_scale)
        return energy + detections(self._skeleton, angles, seen, scale, H, gradient)  # pyright: ignore[reportCallIssue]

    def _total(self, colours, angles, predicted, scatter, seen=None, term=None):
        colour = evaluation = self.model.evaluate(angles, colours, curvature=True)
        if seen is not None and evaluation.curvature is not None:
            movable = movable_angles((seen.weights > 0.0).any(0))
            evaluation = Evaluation(
                evaluation.energy, evaluation.gradient * movable,
                evaluation.curvature * np.outer(movable, movable),
            )  # fmt: skip
        energy, gradient, H = self._with_priors(evaluation, angles, predicted, scatter)
        if seen is not None:
            scale = float(self.priors_config.robust_scale)
            energy += detections(self._skeleton, angles, seen, scale, H, gradient)  # pyright: ignore[reportCallIssue]
        if term is not None:
            energy += term(angles, H, gradient)
        return energy, gradient, H, colour

    def _with_priors(
        self, colour: Evaluation, angles: Float[Array, "37"], predicted, scatter
    ) -> tuple[float, Float[Array, "37"], Float[Array, "37 37"]]:
        """Energy, gradient and the lower triangle of the Gauss-Newton matrix of all terms."""
        H, g = np.zeros((DOF_COUNT, DOF_COUNT)), np.zeros(DOF_COUNT)
        energy = priors(self._skeleton, angles, H, g)
        if predicted is not None:
            energy += smoothness(self._skeleton, angles, predicted, scatter, H, g)
        if colour.curvature is not None:
            H += self._weight * colour.curvature
        return energy + self._weight * colour.energy, g + self._weight * colour.gradient, H

    def _step(self, gradient, H, damping) -> Float[Array, "37"]:
        step, L = np.zeros(DOF_COUNT), np.zeros((DOF_COUNT, DOF_COUNT))
        free = np.flatnonzero(self.free)
        inner = np.ascontiguousarray(H[np.ix_(free, free)]) + 1e-9 * np.eye(len(free))
        x, right = np.zeros(len(free)), -gradient[free]
        while not cholesky_solve(inner, damping, right, L, x):
            damping = max(10.0 * damping, 1e-6)
        longest = np.abs(x).max()
        # The linearisation does not hold over more than a third of a radian.
        step[free] = x * min(1.0, 0.3 / max(longest, 1e-12))
        return step


def _detected(observations: Observations | None, frame: int):
    if observations is None:
        return None
    return observations.frame(frame)


def track_colours(
    solver: ImageSolver,
    frames,
    start: Float[Array, "37"],
    fps: float,
) -> list[Solution]:
    """Track a pose through the colours of successive frames, each given its past alone.

    Frames are colours for `ImageModel.evaluate`; a generator that calls `ColourTerm.set_images`
    gives each frame's colours against the background at the last pose.

    `start` is the pose at the first frame.
    """
    found: list[Solution] = []
    scatter = np.maximum(solver.priors_config.velocity_sigma / fps * SPREAD, 1e-3)
    last = before = np.asarray(start, float)
    for colours in frames:
        predicted = predict(last, before, solver.priors_config.zeta)
        predicted = np.where(solver.free, predicted, start)
        solution = solver.solve(colours, predicted, predicted, scatter)
        last, before = solution.angles, last
        found.append(solution)
    return found
