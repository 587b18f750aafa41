"""The images' term of the energy, frame by frame, to be added to a solver's own terms.

    term = ColourTerm(body, rig, palette)
    term.set_images(frame.images, predicted)       # once a frame
    energy += term.add(angles, H, g)        # once a step
    term.update_illumination(angles)                     # once a frame, to follow the light

The term is a negative log-likelihood times `weight`. Errors of neighbouring pixels are correlated,
as the body is not made of spheres and cloth folds, so that a pixel counts far less than an
independent measurement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8
from numpy import ndarray as Array

from egocap.body.gaussians import GaussianBody
from egocap.body.proportions import Proportions
from egocap.body.skeleton import LABEL_POINTS, MOVES
from egocap.cameras.rig import Rig
from egocap.errors import InputError
from egocap.image_model.illumination import Illumination, learn_in_light
from egocap.image_model.image_rays import PosedFrames, image_rays, ray_colours, require_pictures
from egocap.image_model.kernel_arrays import Palettes
from egocap.image_model.model import Evaluation, ImageModel
from egocap.image_model.palette import BINS, Background, Palette, learn_palette

MIN_JOINTS = 2
"""Joints of a limb that must have been detected before the images may move it."""


def movable_angles(detected: Bool[Array, "18"]) -> Bool[Array, "37"]:
    """Angles that the images may move, given the joints that were detected in any view.

    An occluded limb has almost no pixels; those assigned to it wrongly, past the outline of a trunk
    that is too thin, would pull it far off. An angle is movable when two joints that it moves were
    detected, or all that it moves.
    """
    moved = MOVES[list(LABEL_POINTS)]
    return (moved & detected[:, None]).sum(0) >= np.minimum(moved.sum(0), MIN_JOINTS)


@dataclass(frozen=True)
class ColourTermConfig:
    """Settings of the colour term."""

    size: int = 128
    """Width and height in pixels to which every view is reduced."""
    weight: float = 0.01
    """Weight of one pixel that fits wholly or not at all, at `reference_rays`."""
    reference_rays: int = 28_000
    """Number of rays at which `weight` holds; with fewer rays, each weighs more."""

    def __post_init__(self) -> None:
        if not 16 <= self.size <= 512:
            raise InputError(f"images of {self.size} pixels", valid="16 to 512")
        if not 0.0 <= self.weight < float("inf"):
            raise InputError(f"weight = {self.weight}", valid="a number from 0")
        if self.reference_rays < 1:
            raise InputError(f"reference_rays = {self.reference_rays}", valid="from 1")


class ColourTerm:
    """The colour likelihood of a person against the background, frame after frame.

    Not to be shared between Python threads.
    """

    def __init__(
        self,
        body: GaussianBody,
        rig: Rig,
        palette: Palette,
        config: ColourTermConfig = ColourTermConfig(),
        threads: int | None = None,
        light: Illumination | None = None,
    ) -> None:
        self.config, self.palette, self.light = config, palette, light
        self.model = ImageModel(body, image_rays(rig, config.size, config.size), threads=threads)
        self.weight = config.weight * config.reference_rays / len(self.model.rays)
        self._background = Background()
        self._seen: Palettes | None = None
        self._hsv: Float32[Array, "P 3"] | None = None
        self.visibility: Float32[Array, "P 91"] | None = None
        """Of every Gaussian along every ray, at the pose that `set_images` was given last."""

    @classmethod
    def learned(
        cls, rig: Rig, proportions: Proportions,
        frames: PosedFrames,
        config: ColourTermConfig, adapt_illumination: bool = True,
    ) -> ColourTerm:  # fmt: skip
        """The term of a person whose colours are learned from images of known poses.

        Raises InputError for pictures that are not of the rig's shape.
        """
        require_pictures(rig, frames[0][0], (config.size, config.size))
        body = GaussianBody.from_proportions(proportions)
        rays, light = image_rays(rig, config.size, config.size), None
        if adapt_illumination:
            palette, light = learn_in_light(body, rig, rays, frames)
        else:
            palette = learn_palette(body, rays, frames)
        return cls(body, rig, palette, config, light=light)

    def set_images(
        self, images: Sequence[UInt8[Array, "H W 3"]], pose: Float[Array, "37"] | None = None
    ) -> Palettes:
        """Set a frame's RGB images; returns its colours for `ImageModel.evaluate`.

        The background is learned from the rays that the body at `pose` leaves free. Without a pose,
        the last pose given to `add` is used, which saves an evaluation. Raises
        InputError for another number of images than of views, or without a pose at first.
        """
        if pose is not None:
            self.visibility = self.model.visibility(pose)
            opacity = self.visibility.sum(axis=1)
        elif self._seen is None:
            raise InputError("the first frame needs a pose to separate body and background")
        else:
            opacity = self.model.opacity
        if self.light is not None and self._seen is None and pose is not None:
            self.light.initialise(self._colours(images), pose)
        self._hsv = self._colours(images)
        bins = BINS.of(self._hsv)
        self._background.update(bins, opacity)
        self._seen = self._background.compare(self.palette, bins)
        return self._seen

    def update_illumination(self, angles: Float[Array, "37"]) -> None:
        """Update the estimate of the light from the pose found in the last frame."""
        if self.light is not None and self._hsv is not None:
            self.light.update(self._hsv, angles)

    def _colours(self, images: Sequence[UInt8[Array, "H W 3"]]) -> Float32[Array, "P 3"]:
        return ray_colours(self.model.rays, images, None if self.light is None else self.light.gain)

    def reset_background(self) -> None:
        """Drop the background: the next frame does not follow the last one."""
        self._background, self._seen = Background(), None

    def add(
        self,
        angles: Float[Array, "37"],
        H: Float[Array, "37 37"],
        g: Float[Array, "37"],
        movable: Bool[Array, "37"] | None = None,
        found: Evaluation | None = None,
    ) -> float:
        """Energy at a pose; its gradient is added to g, its Gauss-Newton matrix to H.

        All are multiplied by the weight. Both triangles of the matrix are filled. Angles that are
        not `movable` (see `movable_angles`) get nothing. `found` is the model's last evaluation, if
        it was at this pose. Raises InputError before the first frame.
        """
        if self._seen is None:
            raise InputError("the colour term has no images", valid="set_images() first")
        if found is None:
            found = self.model.evaluate(angles, self._seen, curvature=True)
        assert found.curvature is not None
        gradient, curvature = found.gradient, found.curvature
        if movable is not None:
            gradient, curvature = gradient * movable, curvature * np.outer(movable, movable)
        H += self.weight * curvature
        g += self.weight * gradient
        return self.weight * found.energy
