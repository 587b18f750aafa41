"""The paper's solvers: gradient descent on equation 1, for comparison with the default solver.

`reference` evaluates all pixels; the step of every angle grows while its gradient keeps its sign
and shrinks when it changes (conditioned gradient descent). `stochastic` evaluates random pixels and
Gaussians (section 4.4), with steps by Adam.

Source: EgoCap 2016, sections 4 to 4.4 and 5.2; Riedmiller & Braun 1993, "A direct adaptive method
for faster backpropagation learning: the RPROP algorithm"; Kingma & Ba 2015, "Adam".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array

from egocap.body.skeleton import DOF_COUNT, SPREAD
from egocap.image_model.model import Evaluation, ImageModel
from egocap.image_model.stochastic import PixelSampler
from egocap.paper.config import PaperConfig
from egocap.paper.energy import detection_agreement, pose_prior, smoothness
from egocap.pose.kernel import Model

_GROW, _SHRINK = 1.2, 0.5
_FIRST_STEP, _MAX_STEP, _MIN_STEP = 0.01, 0.1, 1e-6  # rad
_ADAM_STEP = 0.02  # of each angle's prior deviation; decays to a tenth
_SETTLED = 1e-3
"""Converged: the last tenth of the steps brought less than this fraction of the decrease."""


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame's colours and detections, and the predicted pose."""

    colours: Float32[Array, "P 3"]
    centres: Float[Array, "V 3"]
    rays: Float[Array, "V 18 3"]
    confidence: Float[Array, "V 18"]  # 0 where nothing was detected
    predicted: Float[Array, "37"]


@dataclass(frozen=True, eq=False)
class PaperPose:
    """Result of a descent."""

    angles: Float[Array, "37"]
    converged: bool
    first_energy: float  # at the start; nan for random pixels
    energy: float  # at the end; nan for random pixels


class PaperSolver:
    """Solves one frame. Not to be shared between threads."""

    def __init__(self, image: ImageModel, skeleton: Model, config: PaperConfig) -> None:
        self.image, self.skeleton, self.config = image, skeleton, config
        self._per_ray = config.lambda_colour / len(image.rays)
        self._sampler = PixelSampler(image)

    def solve(self, frame: Frame, start: Float[Array, "37"], rng: np.random.Generator) -> PaperPose:
        """Descend from a start, with all rays or with random ones drawn from `rng`."""
        if self.config.rays > 0:
            return PaperPose(self._stochastic(frame, start, rng), True, np.nan, np.nan)
        return self._conditioned(frame, start)

    def terms(self, frame: Frame, angles: Float[Array, "37"]) -> Float[Array, "4"]:
        """Energy of a pose by term, in the order of `egocap.data.track.ENERGY_TERMS`."""
        colour = self._per_ray * self.image.evaluate(angles, frame.colours).energy
        return np.array([*self._others(frame, angles)[0], colour])

    def _conditioned(self, frame: Frame, start: Float[Array, "37"]) -> PaperPose:
        angles, steps = np.array(start, float), np.full(DOF_COUNT, _FIRST_STEP)
        last, energies = np.zeros(DOF_COUNT), []
        best, lowest = angles, np.inf
        for _ in range(self.config.iterations):
            energy, gradient = self._sum(frame, angles, self._seen(frame, angles))
            energies.append(energy)
            if energy < lowest:
                best, lowest = angles, energy
            turned = np.sign(gradient * last)
            steps *= np.where(turned > 0.0, _GROW, np.where(turned < 0.0, _SHRINK, 1.0))
            steps = np.clip(steps, _MIN_STEP, _MAX_STEP)
            angles, last = angles - steps * np.sign(gradient), gradient
        before = min(energies[: -max(len(energies) // 10, 1)], default=np.inf)
        settled = before - lowest <= _SETTLED * max(energies[0] - lowest, 1e-12)
        return PaperPose(best, bool(settled), energies[0], lowest)

    def _stochastic(
        self, frame: Frame, start: Float[Array, "37"], rng: np.random.Generator
    ) -> Float[Array, "37"]:
        config, angles = self.config, np.array(start, float)
        mean, square = np.zeros(DOF_COUNT), np.zeros(DOF_COUNT)
        if config.lambda_colour > 0.0:
            self._sampler.aim(frame.colours, angles)
        for i in range(config.iterations):
            seen = self._seen(frame, angles, rng)
            gradient = self._sum(frame, angles, seen)[1] * SPREAD
            mean, square = 0.8 * mean + 0.2 * gradient, 0.95 * square + 0.05 * gradient**2
            corrected = mean / (1.0 - 0.8 ** (i + 1))
            root = np.sqrt(square / (1.0 - 0.95 ** (i + 1)))
            rate = _ADAM_STEP * 0.1 ** (i / config.iterations)
            angles -= rate * SPREAD * corrected / (root + 1e-12 + 0.1 * root.max())
        return angles

    def _seen(
        self, frame: Frame, angles: Float[Array, "37"], rng: np.random.Generator | None = None
    ) -> Evaluation:
        """Colour energy and gradient, of random rays if there is a generator."""
        if self.config.lambda_colour <= 0.0:
            return Evaluation(0.0, np.zeros(DOF_COUNT))
        if rng is None:
            return self.image.evaluate(angles, frame.colours)
        rays, keep = self.config.rays, self.config.keep
        return self._sampler.estimate(frame.colours, angles, rays, keep, rng)

    def _sum(
        self, frame: Frame, angles: Float[Array, "37"], seen: Evaluation
    ) -> tuple[float, Float[Array, "37"]]:
        terms, gradient = self._others(frame, angles)
        energy = float(terms.sum()) + self._per_ray * seen.energy
        return energy, gradient + self._per_ray * seen.gradient

    def _others(
        self, frame: Frame, angles: Float[Array, "37"]
    ) -> tuple[Float[Array, "3"], Float[Array, "37"]]:
        """Energies of detections, prior and smoothness, and the gradient of their sum."""
        config, g = self.config, np.zeros(DOF_COUNT)
        terms = np.array([
            detection_agreement(
                self.skeleton, angles, frame.centres, frame.rays,
                config.lambda_detection * frame.confidence, config.detection_sigma, g,
            ),
            pose_prior(self.skeleton, angles, config.lambda_pose, config.lambda_limit, g),
            smoothness(angles, frame.predicted, config.lambda_smooth, g),
        ])  # fmt: skip
        return terms, g
