"""Online tracking by appearance alone: the paper's live test.

The person's colours are learned from the first images, in a known pose; those of parts that are
hidden there, once they come into view. Colours are compared with what lies behind, which is
unlikely where a pixel moves against the room (`appearance.panorama`, `appearance.moving_pixels`);
points on the body are tracked from image to image (`appearance.surface_points`). There is no
detector: random poses of each arm, compared with the images now and then, find one that was lost
(`appearance.arm_search`).

Source: EgoCap 2016, section 6.3 ("Live test"), which has the colours alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray as Array

from egocap.appearance.arm_search import SIDES, ArmSearch
from egocap.appearance.moving_pixels import MovingPixels
from egocap.appearance.panorama import Panorama
from egocap.appearance.surface_points import SurfacePoints
from egocap.body.gaussians import GaussianBody
from egocap.body.proportions import Proportions
from egocap.body.skeleton import DOF_COUNT, SPREAD, forward
from egocap.cameras.rig import Rig
from egocap.errors import InputError
from egocap.image_model.colour_solver import ImageSolver, ImageSolverConfig
from egocap.image_model.colour_term import ColourTermConfig
from egocap.image_model.image_rays import image_rays, ray_colours, ray_image, require_pictures
from egocap.image_model.kernel_arrays import Palettes
from egocap.image_model.model import Evaluation, ImageModel
from egocap.image_model.palette import CLEAR, OWN_PIXELS, ColourBins, ColourCounts, Palette
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
_STEPS = 3  # Gauss-Newton steps a frame
_LEARN_EVERY, _SEARCH_EVERY = 6, 3
"""Frames from one learning of hidden colours to the next, and from one search for an arm."""
_GAIN, _FAR = 3.0, 0.12
"""Energy by which an arm's pose found elsewhere must be lower, and metres that make it elsewhere;
nearer, the descent finds it."""
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
        self._solver = ImageSolver(self._images, config, PRIORS)
        self._weight = term.weight * term.reference_rays / len(rays)
        self._searches = [ArmSearch(rig, rays, body, side) for side in range(len(SIDES))]
        self._arm_solvers = [
            ImageSolver(self._images, config, PRIORS, s.angles) for s in self._searches
        ]
        self._points = SurfacePoints(rig, body)
        self._moving = MovingPixels(self._points.rig, rays)
        self._panorama, self._gain = Panorama(rays, _BINS), np.ones(3)
        self._opacity = np.zeros(len(rays), np.float32)
        self._counts = ColourCounts(body, _BINS)
        self._upper = np.array([not part.endswith(_LEG_PARTS) for part in body.parts])
        self._hidden = self._upper
        self._palette: Palette | None = None
        self._frames = 0

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
        information, converged = self._follow(there, elapsed)
        return [self._pose(time, elapsed, information, converged)]

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
        self._counts.add(seen, _BINS.of(hsv))
        self._palette = Palette(self._counts.log_density())
        self._hidden = self._upper & (self._counts.pixels < OWN_PIXELS)
        self._opacity = seen.sum(1)
        self._panorama.update(hsv, self._opacity)
        self._points.follow(images, self._start)
        self._points.settle(self._start, ray_image(self._rays, self._opacity, 0.0))
        colours = self._panorama.compare(self._palette, hsv)  # compile what `step` calls
        self._solver.solve(colours, self._start, term=self._points.add)
        for search in self._searches:
            search.propose(self._start, colours.unlike)

    def _follow(
        self, images: Sequence[UInt8[Array, "H W 3"]], elapsed: float
    ) -> tuple[Float[Array, "37 37"], bool]:
        """Find the pose in the next images; what they tell of its angles, and convergence."""
        assert self._palette is not None
        self._frames += 1
        predicted = predict(self._last, self._before, PRIORS.zeta)
        scatter = np.maximum(PRIORS.velocity_sigma * elapsed * SPREAD, 1e-3)
        turn, moved = self._points.follow(images, predicted), np.zeros(len(self._rays))
        if turn is not None:
            self._panorama.turn(turn)
            moved = self._moving.measure(
                self._points.before, self._points.grey, turn, self._opacity < CLEAR
            )
        hsv = ray_colours(self._rays, images, self._gain)
        colours = self._panorama.compare(self._palette, hsv, moved)
        found = self._solver.solve(colours, predicted, predicted, scatter, term=self._points.add)
        self._before, self._last, colour = self._last, found.angles, found.colour
        if self._frames % _SEARCH_EVERY == 0 and self._search(colours):
            colour = None
        colour = colour or self._images.evaluate(self._last, colours, curvature=True)
        information = self._information(colour)
        self._learn_more(hsv, moved)
        return information, found.converged

    def _search(self, colours: Palettes) -> bool:
        """Look for one of the arms elsewhere; whether the images were compared with other poses."""
        side = self._frames // _SEARCH_EVERY % len(SIDES)
        search, solver = self._searches[side], self._arm_solvers[side]
        start = search.propose(self._last, colours.unlike)
        if start is None:
            return False
        found = solver.solve(colours, start)
        joints = (forward(self.proportions, angles) for angles in (found.angles, self._last))
        away = np.linalg.norm(np.subtract(*joints), axis=1).max()
        if away > _FAR and found.energy < solver.energy(colours, self._last) - _GAIN:
            self._last = self._before = found.angles
            self._points.forget(search.joints)
        return True

    def _information(self, colour: Evaluation) -> Float[Array, "37 37"]:
        assert colour.curvature is not None
        information = self._weight * colour.curvature
        self._points.add(self._last, information, np.zeros(DOF_COUNT))
        return information

    def _learn_more(self, hsv: Float32[Array, "P 3"], moved: Float[Array, "P"]) -> None:
        """Learn from the last images, given their colours along the rays and the pose found."""
        assert self._palette is not None
        self._opacity = self._images.opacity
        foreign = np.where(moved > 0.0, 1.0, self._opacity)
        change = self._panorama.light(hsv, foreign)
        self._panorama.update(hsv, foreign)
        if change is not None:
            self._gain = self._gain * change
        self._points.settle(self._last, ray_image(self._rays, self._opacity, 0.0))
        if self._hidden.any() and self._frames % _LEARN_EVERY == 0:
            self._learn_hidden(hsv, self._images.visibility(self._last))

    def _learn_hidden(self, hsv: Float32[Array, "P 3"], seen: Float32[Array, "P 91"]) -> None:
        assert self._palette is not None
        new = self._hidden & (seen.max(0) > _PLAIN)
        if new.any():
            self._counts.add(seen, _BINS.of(hsv), new)
            log_density = self._palette.log_density.copy()
            log_density[self._hidden] = self._counts.log_density(self._hidden)
            self._palette = Palette(log_density)
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
