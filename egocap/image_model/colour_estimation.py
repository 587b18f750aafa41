"""Colours of the Gaussians, read off images in which the pose is known (personalisation)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.body.gaussians import GaussianBody
from egocap.image_model.colour import hsv_to_rgb, rgb_to_hsv
from egocap.image_model.image_rays import ImageRays, ray_colours
from egocap.image_model.model import ImageModel

SEEN = 0.3
"""Pixels' worth of visibility under which a Gaussian's colour is taken from its part's others."""


def colour_body(
    body: GaussianBody,
    rays: ImageRays,
    images: Sequence[UInt8[Array, "H W 3"]],
    angles: Float[Array, "37"],
) -> GaussianBody:
    """The body in the colours that one frame shows at a known pose.

    A Gaussian takes the mean of the pixels, each weighted by the square of how much of it is seen
    there: pixels that it fills, not those at its rim. One that is hidden takes its part's colour,
    or the same part's of the other side, or the mean of all.
    """
    weights = ImageModel(body, rays).visibility(angles) ** 2
    rgb = hsv_to_rgb(ray_colours(rays, images))
    mass, sums = weights.sum(0).astype(float), weights.T.astype(float) @ rgb
    colour = sums / np.maximum(mass, 1e-9)[:, None]
    names = np.array(body.parts)
    plain = np.array([n.removeprefix("left_").removeprefix("right_") for n in names])
    for q in np.flatnonzero(mass < SEEN):
        for group in (names == names[q], plain == plain[q], np.ones(len(names), bool)):
            if mass[group].sum() >= SEEN:
                colour[q] = sums[group].sum(0) / mass[group].sum()
                break
    return body.with_colour(rgb_to_hsv(np.clip(colour, 0.0, 1.0)))
