"""Contour energy: edges of the body's density against edges of the images, for body fitting.

Knows no colours, so that a body can be fitted to images before its colours are. Torch, so that
autograd gives the derivatives by angles, sizes and offsets alike; fitting is not done live.

With B the share of light that the body absorbs along a pixel's ray, and I the image,

    E = sum over pixels of -|dB| |dI| cos(2 angle(dB, dI)) + |dB| max(0, flat - |dI|)

An edge of the body on a parallel image edge of either polarity lowers the energy, on a crossing one
raises it, and one where the image is flat costs. Derivatives are central differences of pixels.

Source: EgoCap 2016, section 4.1, after Rhodin et al. 2016, "General automatic human shape and
motion capture using volumetric contour cues"; the rays of its model are those of the fisheye views.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float, UInt8
from numpy import ndarray as Array
from torch import Tensor

from egocap.errors import InputError
from egocap.image_model.image_rays import ImageRays
from egocap.image_model.visibility import along_rays, optical_depth

FLAT = 0.1
"""Image gradient, in brightness a pixel, under which an edge of the body is unwelcome."""
FAR = 10.0
"""Distance in metres by which every ray has left the body."""
_TINY = 1e-6


def image_edges(rays: ImageRays, images: Sequence[UInt8[Array, "H W 3"]]) -> Float[Array, "P 2"]:
    """Image gradient at every ray, per pixel: that of the colour channel where it is steepest.

    Brightness runs from 0 to 1. Larger images are averaged down first. Raises InputError when there
    is not one image a view.
    """
    import cv2

    if len(images) != len(rays.origins):
        raise InputError(f"{len(images)} images", valid=f"{len(rays.origins)}, one a view")
    found = np.zeros((len(rays), 2))
    for view, image in enumerate(images):
        scaled = cv2.resize(image, rays.size, interpolation=cv2.INTER_AREA) / 255.0
        slopes = np.stack([np.gradient(scaled, axis=1), np.gradient(scaled, axis=0)], -1)
        steepest = np.argmax((slopes**2).sum(-1), axis=-1)[..., None, None]
        edges = np.take_along_axis(slopes, steepest, axis=2)[:, :, 0]
        mine = rays.view == view
        found[mine] = edges[rays.pixel[mine, 1], rays.pixel[mine, 0]]
    return found


def opacity(
    centres: Float[Tensor, "*batch G 3"],
    sigma: Float[Tensor, "G"],
    density: Float[Tensor, "G"],
    origins: Float[Tensor, "P 3"],
    directions: Float[Tensor, "P 3"],
) -> Float[Tensor, "*batch P"]:
    """Share of the light that the whole body absorbs along rays: 1 - T(infinity)."""
    met = along_rays(centres, sigma, density, origins, directions)
    end = met.middle.new_full((*met.middle.shape[:-1], 1), FAR)
    return -torch.expm1(-optical_depth(met, end)[..., 0, :].sum(-1))


def contour_energy(
    centres: Float[Tensor, "G 3"],
    sigma: Float[Tensor, "G"],
    density: Float[Tensor, "G"],
    rays: ImageRays,
    edges: Float[Tensor, "P 2"],
    flat: float = FLAT,
) -> Float[Tensor, ""]:
    """How badly the body's outline in all views lies on the edges that `image_edges` found.

    Only pixels with four neighbours inside the lens count.
    """
    origins, directions = (centres.new_tensor(a) for a in (rays.origins[rays.view], rays.direction))
    absorbed = opacity(centres, sigma, density, origins, directions)
    width, height = rays.size
    view, u, v = (torch.as_tensor(a, dtype=torch.long, device=centres.device)
                  for a in (rays.view, rays.pixel[:, 0], rays.pixel[:, 1]))  # fmt: skip
    shape = (len(rays.origins), height, width)
    plane = absorbed.new_zeros(shape).index_put((view, v, u), absorbed)
    there = torch.zeros(shape, dtype=torch.bool, device=centres.device)
    there[view, v, u] = True
    inner = _inner(there)[view, v, u]
    slope_u = (torch.roll(plane, -1, 2) - torch.roll(plane, 1, 2)) / 2
    slope_v = (torch.roll(plane, -1, 1) - torch.roll(plane, 1, 1)) / 2
    body = torch.stack([slope_u, slope_v], -1)[view, v, u][inner]
    image = edges[inner]
    body_length = torch.sqrt((body**2).sum(-1) + _TINY**2)
    image_length = torch.sqrt((image**2).sum(-1) + _TINY**2)
    # |a| |b| cos 2x = 2 (a . b)^2 / (|a| |b|) - |a| |b|
    product = body_length * image_length
    agreement = 2.0 * (body * image).sum(-1) ** 2 / product - product
    return (body_length * (flat - image_length).clamp(min=0.0) - agreement).sum()


def _inner(there: Tensor) -> Tensor:
    """Pixels whose four neighbours are there as well."""
    inner = there.clone()
    for axis, steps in ((1, (1, -1)), (2, (1, -1))):
        for step in steps:
            inner &= torch.roll(there, step, axis)
    inner[:, (0, -1)] = False
    inner[:, :, (0, -1)] = False
    return inner
