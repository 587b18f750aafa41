"""A simulated sequence with a coloured body and detections, for the image model's studies."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.gaussians import GaussianBody
from egocap.body.labels import EVALUATED, UPPER
from egocap.body.skeleton import DOF_COUNT, forward
from egocap.data.sequence import Sequence
from egocap.data.truth import VISIBLE
from egocap.detect.sources import synthetic_detections
from egocap.image_model.colour_measure import PAPER, ColourMeasure
from egocap.image_model.colour_solver import ImageSolver, ImageSolverConfig
from egocap.image_model.colour_term import ColourTerm, ColourTermConfig
from egocap.image_model.image_rays import image_rays
from egocap.image_model.model import ImageModel
from egocap.image_model.palette import colour_body, learn_palette
from egocap.pose.config import TrackerConfig
from egocap.pose.inverse_kinematics import nearest_angles
from egocap.pose.observations import Observations, observe

LEARNED = 5


@dataclass(frozen=True)
class Trial:
    """Mean errors before and after solving, metres."""

    before: float
    after: float
    visible: float  # of the joints that a view sees, after


class Scene:
    """Frames of a sequence, a body with learned colours, and simulated detections.

    Colours are learned in `LEARNED` frames spread over the sequence, at their true poses, as in a
    personalisation.
    """

    def __init__(self, folder: Path) -> None:
        self.sequence = sequence = Sequence(folder)
        self.name = folder.name
        truth = sequence.truth
        self.joints = truth.joints_head
        self.seen = (truth.visibility == VISIBLE).any(1)  # (T, 18)
        self.poses = [nearest_angles(sequence.body, joints) for joints in self.joints]
        rays = image_rays(sequence.rig, 128, 128)
        body = GaussianBody.from_proportions(sequence.body)
        spread = np.linspace(0, len(self.poses) - 1, LEARNED).round().astype(int)
        shown = [(sequence.images(int(t)), self.poses[t]) for t in spread]
        self.palette = learn_palette(body, rays, shown)
        self.body = colour_body(body, rays, *shown[0])
        self.term = ColourTerm(self.body, sequence.rig, self.palette)
        self.paper = ImageModel(self.body, rays, measure=PAPER)
        self._observations: dict[float, Observations] = {}

    def observations(self, pixels: float) -> Observations:
        """Simulated detections with noise of `pixels`."""
        if pixels not in self._observations:
            found = synthetic_detections(self.sequence, pixels)
            self._observations[pixels] = observe(
                found, self.sequence.rig, self.sequence.body, TrackerConfig()
            )
        return self._observations[pixels]

    def solve(
        self,
        t: int,
        start: Float[Array, "37"],
        free: Bool[Array, "37"] | None = None,
        pixels: float | None = None,
        weight: float | None = None,
        measure: ColourMeasure | None = None,
    ) -> Float[Array, "37"]:
        """Solve a frame from a start; by the palette unless `measure` is given."""
        model = self.term.model if measure is None else self.paper
        images = self.sequence.images(t)
        if measure is None:
            self.term.reset_background()
            colours = self.term.set_images(images, start)
        else:
            colours = model.colours(images)
        alone = ImageSolverConfig().lambda_colour
        usual = alone if pixels is None else ColourTermConfig().weight
        config = ImageSolverConfig(
            lambda_colour=usual if weight is None else weight, iterations=30, tolerance=1e-4
        )
        known = None if pixels is None else self.observations(pixels)
        return ImageSolver(model, config, free=free).solve(
            colours, start, observations=known, frame=t
        ).angles  # fmt: skip

    def trial(
        self,
        size_deg: float,
        rng: np.random.Generator,
        free: Bool[Array, "37"] | None = None,
        pixels: float | None = None,
        weight: float | None = None,
        measure: ColourMeasure | None = None,
    ) -> Trial:
        """Perturb a random frame's pose, solve, and compare with the truth."""
        t = int(rng.integers(len(self.poses)))
        shift = np.deg2rad(size_deg) * rng.uniform(-1.0, 1.0, DOF_COUNT)
        start = self.poses[t] + (shift if free is None else np.where(free, shift, 0.0))
        found = self.solve(t, start, free, pixels, weight, measure)
        judged = np.array(UPPER if free is not None else EVALUATED)
        before, after = (self.errors(angles, t)[judged] for angles in (start, found))
        visible = after[self.seen[t][judged]]
        return Trial(float(before.mean()), float(after.mean()), float(visible.mean()))

    def compare(
        self, t: int, pixels: float, rng: np.random.Generator
    ) -> tuple[tuple[float, float], tuple[float, float]]:
        """Error of all and of the visible joints, without and with colour beside detections."""
        start = self.poses[t] + np.deg2rad(5.0) * rng.uniform(-1.0, 1.0, DOF_COUNT)
        without = self.solve(t, start, pixels=pixels, weight=0.0)
        with_ = self.solve(t, without, pixels=pixels)
        judged, seen = np.array(EVALUATED), self.seen[t]
        both = [self.errors(angles, t)[judged] for angles in (without, with_)]
        first, second = ((float(e.mean()), float(e[seen[judged]].mean())) for e in both)
        return first, second

    def errors(self, angles: Float[Array, "37"], t: int) -> Float[Array, "18"]:
        """Distance of every joint from the truth, metres."""
        joints = forward(self.sequence.body, angles)
        return np.linalg.norm(joints - self.joints[t], axis=-1)
