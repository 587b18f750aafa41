"""Online tracking of the upper body by appearance alone: the paper's live test.

The person's colours are learned from the first images, in a known pose; those of parts that are
hidden there, once they come into view. Colours are compared with what lies behind
(`panorama.Panorama`); points on the body are tracked from image to image
(`surface_points.SurfacePoints`). There is no detector: nothing searches for a lost arm. Legs keep
their first pose.

Source: EgoCap 2016, section 6.3 ("Live test"), which has the colours alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray as Array

from egocap.body.gaussians import GaussianBody
from egocap.body.proportions import Proportions
from egocap.body.skeleton import DOF_COUNT, SPREAD, forward
from egocap.cameras.rig import Rig
from egocap.errors import InputError
from egocap.image_model.colour_solver import UPPER_BODY, ImageSolver, ImageSolverConfig, Solution
from egocap.image_model.colour_term import ColourTermConfig
from egocap.image_model.illumination import Illumination
from egocap.image_model.image_rays import image_rays, ray_colours, ray_image, require_pictures
from egocap.image_model.model import ImageModel
from egocap.image_model.palette import OWN_PIXELS, ColourBins, ColourCounts, Palette
from egocap.image_model.panorama import Panorama
from egocap.image_model.surface_points import SurfacePoints
from egocap.pose.config import TrackerConfig
from egocap.pose.energy import predict
from egocap.pose.kernel import make_model, priors
from egocap.track.online import PoseEstimate, require_later
from egocap.track.uncertainty import confidences, joint_covariances, update_covariance

TERM = ColourTermConfig(size=64, weight=0.06)
PRIORS = TrackerConfig(smoothing="none", zeta=0.7, velocity_sigma=5.0)
"""A wider prediction than with detections, for fast hands."""
_BINS = ColourBins(20, 24)
_LEG_PARTS = ("thigh", "shank", "foot")
_PLAIN = 0.7
"""Visibility along some ray from which more is learned."""
_LEARN_PIXELS = 60.0
"""Pixels from which the colours of a Gaussian are learned that the first images hid."""
_STEPS = 4  # Gauss-Newton steps a frame
_FRAME_S = 1.0 / 30.0  # before the first frame
_START_SIGMA = 0.2
"""Standard deviation of the first pose, in each angle's prior deviation."""
_DRIFT = TrackerConfig().velocity_sigma
"""Standard deviation of the motion for the covariance, in prior deviations per second."""


class ColourTracker:
    """Tracks a person of known proportions from a known pose. Not to be shared between threads.

    `start` are the angles of the first frame.
    """

    def __init__(
        self, rig: Rig, proportions: Proportions, start: Float[Array, "37"],
        term: ColourTermConfig = TERM,
    ) -> None:  # fmt: skip
        self.rig, self.proportions = rig, proportions
        self._start = np.array(start, float)
        self._model = make_model(proportions, PRIORS)
        self._time = -np.inf
        self._last = self._before = self._start
        self._covariance = np.diag(np.square(_START_SIGMA * SPREAD))
        body, rays = (
            GaussianBody.from_proportions(proportions),
            image_rays(rig, term.size, term.size),
        )
        self._rays, self._images = rays, ImageModel(body, rays)
        config = ImageSolverConfig(lambda_colour=term.weight, iterations=_STEPS)
        self._solver = ImageSolver(self._images, config, PRIORS, UPPER_BODY)
        self._weight = term.weight * term.reference_rays / len(rays)
        self._points = SurfacePoints(rig, body)
        self._panorama = Panorama(rays, _BINS)
        self._light = Illumination(body, rig, rays)
        self._counts = ColourCounts(body, _BINS)
        self._upper = np.array([not part.endswith(_LEG_PARTS) for part in body.parts])
        self._hidden = self._upper
        self._palette: Palette | None = None

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
        if self._palette is None:
            if len(there) < len(images):
                raise InputError("no first picture of every view, to learn the colours from")
            self.learn(there)
        if len(there) < len(images):
            self._before = self._last
            nothing = np.zeros((DOF_COUNT, DOF_COUNT))
            return [self._pose(time, elapsed, nothing, converged=False)]
        found, information = self._follow(there, elapsed)
        return [self._pose(time, elapsed, information, found.converged)]

    def finish(self) -> list[PoseEstimate]:
        """No pose is withheld."""
        return []

    def learn(self, images: Sequence[UInt8[Array, "H W 3"]]) -> None:
        """Learn the person's colours from images of all views in the starting pose.

        Takes a second, and longer where kernels must be compiled; the first `step` does it if it
        was not done before. Raises InputError for images of another aspect than the rig's.
        """
        require_pictures(self.rig, images, self._rays.size)
        hsv = ray_colours(self._rays, images)
        seen = self._images.visibility(self._start)
        self._light.learn(hsv, self._start)
        self._counts.add(seen, _BINS.of(hsv))
        self._palette = Palette(self._counts.log_density())
        self._hidden = self._upper & (self._counts.pixels < OWN_PIXELS)
        self._panorama.update(hsv, seen.sum(1))
        self._points.follow(images, self._start)
        self._points.settle(self._start, ray_image(self._rays, seen.sum(1), 0.0))
        colours = self._panorama.compare(self._palette, hsv)  # compile what `step` calls
        self._solver.solve(colours, self._start, term=self._points.add)

    def _follow(
        self, images: Sequence[UInt8[Array, "H W 3"]], elapsed: float
    ) -> tuple[Solution, Float[Array, "37 37"]]:
        """The pose in the next images, and what they tell of its angles."""
        assert self._palette is not None
        predicted = np.where(
            UPPER_BODY, predict(self._last, self._before, PRIORS.zeta), self._start
        )
        scatter = np.maximum(PRIORS.velocity_sigma * elapsed * SPREAD, 1e-3)
        turn = self._points.follow(images, predicted)
        if turn is not None:
            self._panorama.turn(turn)
        hsv = ray_colours(self._rays, images, self._light.gain)
        colours = self._panorama.compare(self._palette, hsv)
        found = self._solver.solve(colours, predicted, predicted, scatter, term=self._points.add)
        self._before, self._last = self._last, found.angles
        colour = found.colour or self._images.evaluate(self._last, colours, curvature=True)
        assert colour.curvature is not None
        information = self._weight * colour.curvature
        self._points.add(self._last, information, np.zeros(DOF_COUNT))
        self._learn_more(hsv)
        return found, information * np.outer(UPPER_BODY, UPPER_BODY)

    def _learn_more(self, hsv: Float32[Array, "P 3"]) -> None:
        """Learn from the last images, given their colours along the rays and the pose found."""
        assert self._palette is not None
        seen = self._images.visibility(self._last)
        opacity = seen.sum(1)
        self._panorama.update(hsv, opacity)
        self._points.settle(self._last, ray_image(self._rays, opacity, 0.0))
        self._light.update(hsv, self._last)
        new = self._hidden & (seen.max(0) > _PLAIN)
        if new.any():
            self._counts.add(seen, _BINS.of(hsv), new)
            self._palette.log_density[self._hidden] = self._counts.log_density(self._hidden)
            self._hidden = self._hidden & (self._counts.pixels < _LEARN_PIXELS)

    def _pose(
        self, time: float, elapsed: float, information: Float[Array, "37 37"], converged: bool
    ) -> PoseEstimate:
        """The current pose, and its confidence by the past and by what the images tell."""
        H, g = np.zeros((DOF_COUNT, DOF_COUNT)), np.zeros(DOF_COUNT)
        priors(self._model, self._last, H, g)
        H = H + np.tril(H, -1).T + information
        self._covariance = update_covariance(self._covariance, H, _DRIFT * elapsed)
        covariance = joint_covariances(
            self.proportions, self._last[None], self._covariance[None], PRIORS.model_error_m
        )
        joints = forward(self.proportions, self._last)
        return PoseEstimate(time, self._last, joints, covariance[0], confidences(covariance)[0],
                        converged)  # fmt: skip
