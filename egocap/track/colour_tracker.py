"""Online tracking of the upper body by colour alone: the paper's live test.

The person's colours are learned from the first images, in a known pose. There is no detector, so
that a lost arm is not recovered; legs keep their first pose.

Source: EgoCap 2016, section 6.3 ("Live test").
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.body.proportions import Proportions
from egocap.body.skeleton import DOF_COUNT, SPREAD, forward
from egocap.cameras.rig import Rig
from egocap.errors import InputError
from egocap.image_model.colour_solver import UPPER_BODY, ImageSolver, ImageSolverConfig, Solution
from egocap.image_model.colour_term import ColourTerm, ColourTermConfig
from egocap.pose.config import TrackerConfig
from egocap.pose.energy import predict
from egocap.pose.kernel import make_model, priors
from egocap.track.online import PoseEstimate, require_later
from egocap.track.uncertainty import confidences, joint_covariances, update_covariance

TERM = ColourTermConfig(size=64, weight=0.03)
PRIORS = TrackerConfig(smoothing="none", zeta=0.7, velocity_sigma=8.0)
"""A wider prediction than with detections, for fast hands."""
_STEPS = 4  # Gauss-Newton steps a frame
_FRAME_S = 1.0 / 30.0  # before the first frame
_START_SIGMA = 0.2
"""Standard deviation of the first pose, in each angle's prior deviation."""
_DRIFT = TrackerConfig().velocity_sigma
"""Standard deviation of the motion for the covariance, in prior deviations per second."""


class ColourTracker:
    """Tracks a person of known proportions from a known pose. Not to be shared between threads.

    `start` are the angles of the first frame. With `rng`, every frame is solved by the paper's
    descent over random pixels and Gaussians, else by Gauss-Newton.
    """

    def __init__(
        self, rig: Rig, proportions: Proportions, start: Float[Array, "37"],
        term: ColourTermConfig = TERM, rng: np.random.Generator | None = None,
    ) -> None:  # fmt: skip
        self.rig, self.proportions, self._settings, self._rng = rig, proportions, term, rng
        self._start = np.array(start, float)
        self._model = make_model(proportions, PRIORS)
        self._time = -np.inf
        self._last = self._before = self._start
        self._covariance = np.diag(np.square(_START_SIGMA * SPREAD))
        self._term: ColourTerm | None = None
        self._solver: ImageSolver | None = None

    def step(
        self, images: Sequence[UInt8[Array, "H W 3"] | None], time: float
    ) -> list[PoseEstimate]:
        """The pose in the next images, one a view, at a time in seconds.

        The pose stays if an image is missing. Raises InputError for a time that is not later than
        the last, another number of images than of views, and if one of the first is missing.
        """
        elapsed = require_later(time, self._time)
        there = [image for image in images if image is not None]
        elapsed = elapsed if np.isfinite(elapsed) else _FRAME_S
        self._time = time
        if self._term is None or self._solver is None:
            if len(there) < len(images):
                raise InputError("no first picture of every view, to learn the colours from")
            self.learn(there)
        if len(there) < len(images):
            self._before = self._last
            return [self._pose(time, elapsed, None)]
        return [self._pose(time, elapsed, self._follow(there, elapsed))]

    def finish(self) -> list[PoseEstimate]:
        """No pose is withheld."""
        return []

    def learn(self, images: Sequence[UInt8[Array, "H W 3"]]) -> None:
        """Learn the person's colours from images of all views in the starting pose.

        Takes a second or more; the first `step` does it if it was not done before. Raises
        InputError for images of another aspect than the rig's.
        """
        shown = [(images, self._start)]
        self._term = ColourTerm.learned(self.rig, self.proportions, shown, self._settings)
        config = ImageSolverConfig(lambda_colour=self._settings.weight, iterations=_STEPS)
        self._solver = ImageSolver(self._term.model, config, PRIORS, UPPER_BODY)

    def _follow(self, images: Sequence[UInt8[Array, "H W 3"]], elapsed: float) -> Solution:
        assert self._term is not None and self._solver is not None
        first = self._last is self._start
        colours = self._term.set_images(images, self._start if first else None)
        predicted = np.where(
            UPPER_BODY, predict(self._last, self._before, PRIORS.zeta), self._start
        )
        scatter = np.maximum(PRIORS.velocity_sigma * elapsed * SPREAD, 1e-3)
        if self._rng is None:
            found = self._solver.solve(colours, predicted, predicted, scatter)
        else:
            found = self._solver.descend(colours, predicted, self._rng, predicted, scatter)
        self._before, self._last = self._last, found.angles
        self._term.update_illumination(found.angles)
        return found

    def _pose(self, time: float, elapsed: float, found: Solution | None) -> PoseEstimate:
        """The current pose, and its confidence by the past and, if it was solved, by colour."""
        H, g = np.zeros((DOF_COUNT, DOF_COUNT)), np.zeros(DOF_COUNT)
        priors(self._model, self._last, H, g)
        H = H + np.tril(H, -1).T
        if found is not None:
            assert self._term is not None
            self._term.add(self._last, H, g, UPPER_BODY, found.colour)
        self._covariance = update_covariance(self._covariance, H, _DRIFT * elapsed)
        covariance = joint_covariances(
            self.proportions, self._last[None], self._covariance[None], PRIORS.model_error_m
        )
        joints = forward(self.proportions, self._last)
        return PoseEstimate(time, self._last, joints, covariance[0], confidences(covariance)[0],
                        found is not None and found.converged)  # fmt: skip
