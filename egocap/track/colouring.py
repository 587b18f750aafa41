"""Colours of the Gaussians, read off images in which the pose is known (personalisation)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.gaussians import GaussianBody
from egocap.track.appearance import RayBatch
from egocap.track.colour import hsv_to_rgb, rgb_to_hsv
from egocap.track.image_rays import ImageRays, ray_colours
from egocap.track.posing import pose_gaussians
from egocap.track.visibility import along_rays, cell_visibility

SEEN = 0.3
"""Pixels' worth of visibility under which a Gaussian's colour is taken from its part's others."""


def ray_visibility(
    body: GaussianBody, rays: ImageRays, angles: Float[Array, "37"], chunk: int = 1024
) -> Float[Array, "P 91"]:
    """Visibility of every Gaussian along every ray, readable form, single precision."""
    pose = torch.as_tensor(np.asarray(angles), dtype=torch.float32)
    batch = RayBatch.of(rays, np.zeros((len(rays), 3)), torch.float32)
    centres = pose_gaussians(body, pose)
    sigma, density = pose.new_tensor(body.sigma), pose.new_tensor(body.density)
    seen = np.zeros((len(rays), len(body.parts)), np.float32)
    for i in range(0, len(rays), chunk):
        part = slice(i, i + chunk)
        met = along_rays(centres, sigma, density, batch.origins[part], batch.directions[part])
        hit = torch.nonzero(met.depth.sum(-1) > 1e-4)[:, 0]
        if len(hit):
            near = met._replace(middle=met.middle[hit], depth=met.depth[hit])
            seen[i + hit.numpy()] = cell_visibility(near).numpy()
    return seen


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
    weights = ray_visibility(body, rays, angles) ** 2
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
