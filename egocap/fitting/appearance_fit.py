"""Sizes and colours of a person's Gaussians from images in which the pose is known.

Colours are learned at the present sizes, sizes are found with the present colours, in turn: every
part, left and right together, has one factor on its radii that lowers the colour energy of all
frames. The prior keeps a factor that no image determines at 1.

Source: EgoCap 2016, section 4.1, where Rhodin et al. 2016 fit sizes by the outline. Here the
outline is where the colours change from the person's to the background's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.gaussians import GaussianBody
from egocap.body.labels import without_side
from egocap.body.proportions import Proportions
from egocap.cameras.rig import Rig
from egocap.errors import InputError
from egocap.image_model.image_rays import ImageRays, PosedFrames, image_rays, ray_colours
from egocap.image_model.kernel_arrays import Palettes
from egocap.image_model.model import ImageModel
from egocap.image_model.palette import BINS, Background, Palette, colour_body, learn_palette

SPREAD = 0.12
"""Standard deviation of a part's log radius among people."""
WEIGHT = 0.02
"""Weight of one pixel at `RAYS` rays: errors of neighbouring pixels are correlated."""
RAYS = 28_000
STEPS = (0.08, 0.04, 0.02)
"""Steps of the log sizes, one round after another."""


@dataclass(frozen=True, eq=False)
class ShapeFit:
    """The Gaussians of a person."""

    body: GaussianBody  # with sizes, and the mean colour of each
    palette: Palette  # their colours in full
    scales: dict[str, float]  # of every part's radii against the average


def fit_shape(proportions: Proportions, rig: Rig, frames: PosedFrames, size: int = 96) -> ShapeFit:
    """Sizes and colours of the Gaussians of a person from frames of known pose.

    Images are reduced to `size` pixels a side. Raises InputError without frames, and where none
    shows the body.
    """
    if not frames:
        raise InputError("no frames to find sizes and colours in")
    rays = image_rays(rig, size, size)
    plain = GaussianBody.from_proportions(proportions)
    kinds = np.array([without_side(part) for part in plain.parts])
    scales = {str(kind): 0.0 for kind in dict.fromkeys(kinds)}
    bins = [BINS.of(ray_colours(rays, images)) for images, _ in frames]
    body, palette = plain, learn_palette(plain, rays, frames)
    for step in STEPS:
        seen = _against_background(body, palette, rays, frames, bins)
        for kind in scales:
            scales[kind] = _better(plain, kinds, scales, kind, step, rays, frames, seen)
        body = resized(plain, _factors(kinds, scales))
        palette = learn_palette(body, rays, frames)
    images, angles = frames[0]
    body = colour_body(body, rays, images, angles)
    return ShapeFit(body, palette, {k: round(float(np.exp(v)), 3) for k, v in scales.items()})


def resized(body: GaussianBody, factors: Float[Array, "91"]) -> GaussianBody:
    """The body with every Gaussian's radius times a factor, as opaque along its axis as before."""
    return replace(body, sigma=body.sigma * factors, density=body.density / factors)


def _factors(kinds: Array, scales: dict[str, float]) -> Float[Array, "91"]:
    return np.exp([scales[str(kind)] for kind in kinds])


def _against_background(
    body: GaussianBody, palette: Palette, rays: ImageRays, frames: PosedFrames, bins
) -> list[Palettes]:
    """Every frame's colours for `ImageModel.evaluate`."""
    model = ImageModel(body, rays)
    blank = np.zeros((len(rays), 3), np.float32)
    found = []
    for (_, angles), of_frame in zip(frames, bins, strict=True):
        background = Background()
        model.evaluate(angles, blank)
        background.update(of_frame, model.opacity)
        found.append(background.compare(palette, of_frame))
    return found


def _better(plain, kinds, scales, kind, step, rays, frames, seen) -> float:
    """Line search over one part's log size."""

    def energy(log_size: float) -> float:
        body = resized(plain, _factors(kinds, scales | {kind: log_size}))
        model = ImageModel(body, rays)
        pixels = sum(
            model.evaluate(angles, colours).energy
            for (_, angles), colours in zip(frames, seen, strict=True)
        )
        return WEIGHT * RAYS / len(rays) * pixels + 0.5 * (log_size / SPREAD) ** 2

    at, lowest = scales[kind], energy(scales[kind])
    for direction in (step, -step):
        while abs(at + direction) <= 3.0 * SPREAD and (trial := energy(at + direction)) < lowest:
            at, lowest = at + direction, trial
    return at
