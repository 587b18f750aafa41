"""Following the upper body by colour alone, as pictures come: the paper's live test.

The wearer begins in a known pose, in which the first pictures teach the person's colours. No
detector runs, so that nothing brings back an arm that is lost; legs stay where they began.

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
from egocap.track.online import LivePose, carried_on
from egocap.track.uncertainty import confidences, joint_covariances

TERM = ColourTermConfig(size=64, weight=0.03)
PRIORS = TrackerConfig(smoothing="none", zeta=0.7, speed=8.0)
"""Colour alone must follow fast hands from frame to frame: a wider prediction than detections'."""
_STEPS = 4  # Gauss-Newton steps a frame
_USUAL_S = 1.0 / 30.0
_KNOWN = 0.2
"""How well the starting pose is known, in everyday spreads."""
_DRIFT = TrackerConfig().speed
"""By how many spreads a second angles may have moved, for how sure a pose is."""


class ColourTracker:
    """Follows a person of known proportions from a known pose. Not to be shared between threads.

    `start` are the angles of the first picture; those of the legs stay. With `rng`, every frame is
    solved by the paper's descent over random pixels and Gaussians, else by Gauss-Newton.
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
        self._covariance = np.diag(np.square(_KNOWN * SPREAD))
        self._term: ColourTerm | None = None
        self._solver: ImageSolver | None = None

    def step(self, images: Sequence[UInt8[Array, "H W 3"] | None], time: float) -> LivePose:
        """The pose in the next pictures (s, later than the last), one a view.

        Where a picture is missing the pose stays. Raises InputError for a time that is not later
        than the last, another number of pictures than of views, and when the very first is missing.
        """
        if not time > self._time:
            raise InputError(f"a frame of {time:g} s after one of {self._time:g} s",
                             valid="later ones")  # fmt: skip
        there = [image for image in images if image is not None]
        elapsed = time - self._time if np.isfinite(self._time) else _USUAL_S
        self._time = time
        if self._term is None or self._solver is None:
            if len(there) < len(images):
                raise InputError("no first picture of every view, to learn the colours from")
            self.learn(there)
        if len(there) < len(images):
            self._before = self._last
            return self._pose(time, elapsed, None)
        return self._pose(time, elapsed, self._follow(there, elapsed))

    def learn(self, images: Sequence[UInt8[Array, "H W 3"]]) -> None:
        """Learn the person's colours from pictures of all views in the starting pose.

        Takes a second or more; the first `step` does it where it was not done before. Raises
        InputError for pictures of another aspect than the rig's.
        """
        shown = [(images, self._start)]
        self._term = ColourTerm.learned(self.rig, self.proportions, shown, self._settings)
        config = ImageSolverConfig(lambda_colour=self._settings.weight, iterations=_STEPS)
        self._solver = ImageSolver(self._term.model, config, PRIORS, UPPER_BODY)

    def _follow(self, images: Sequence[UInt8[Array, "H W 3"]], elapsed: float) -> Solution:
        assert self._term is not None and self._solver is not None
        first = self._last is self._start
        colours = self._term.see(images, self._start if first else None)
        predicted = np.where(
            UPPER_BODY, predict(self._last, self._before, PRIORS.zeta), self._start
        )
        scatter = np.maximum(PRIORS.speed * elapsed * SPREAD, 1e-3)
        if self._rng is None:
            found = self._solver.solve(colours, predicted, predicted, scatter)
        else:
            found = self._solver.descend(colours, predicted, self._rng, predicted, scatter)
        self._before, self._last = self._last, found.angles
        self._term.settle(found.angles)
        return found

    def _pose(self, time: float, elapsed: float, found: Solution | None) -> LivePose:
        """The pose as it is, and how sure the past and, where it was found by them, colours are."""
        H, g = np.zeros((DOF_COUNT, DOF_COUNT)), np.zeros(DOF_COUNT)
        priors(self._model, self._last, H, g)
        H = H + np.tril(H, -1).T
        if found is not None:
            assert self._term is not None
            self._term.add(self._last, H, g, UPPER_BODY, found.colour)
        self._covariance = carried_on(H, self._covariance, _DRIFT * elapsed)
        covariance = joint_covariances(
            self.proportions, self._last[None], self._covariance[None], PRIORS.model_error_m
        )
        joints = forward(self.proportions, self._last)
        return LivePose(time, self._last, joints, confidences(covariance)[0],
                        found is not None and found.converged)  # fmt: skip
