"""The colour energy, readable: equations 5 and 6 of EgoCap over the rays of all views, in torch.

Batched over poses (frames or hypotheses) on any device, in either precision, differentiable. The
oracle of `egocap.track.image_kernel`, and on a GPU the way to evaluate many poses at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from egocap.gaussians import GaussianBody
from egocap.track.colour import PAPER, ColourMeasure
from egocap.track.image_rays import ImageRays
from egocap.track.posing import pose_gaussians
from egocap.track.visibility import RayGaussians, along_rays, cell_visibility

Quadrature = Callable[[RayGaussians], Tensor]


@dataclass(frozen=True)
class RayBatch:
    """Rays and their image colours, as the colour measure takes them.

    Colours may have a batch axis of their own.
    """

    origins: Float[Tensor, "P 3"]
    directions: Float[Tensor, "P 3"]
    colours: Float[Tensor, "*batch P 3"]

    @classmethod
    def of(
        cls, rays: ImageRays, colours, dtype: torch.dtype = torch.float64, device: str = "cpu"
    ) -> RayBatch:
        """Tensors of rays and of colours (..., P, 3) along them."""
        origins, directions, hsv = (
            torch.as_tensor(a, dtype=dtype, device=device)
            for a in (rays.origins[rays.view], rays.direction, colours)
        )
        return cls(origins, directions, hsv)

    def __getitem__(self, rays) -> RayBatch:
        """Some of the rays."""
        return RayBatch(self.origins[rays], self.directions[rays], self.colours[..., rays, :])


def pixel_energy(
    body: GaussianBody,
    batch: RayBatch,
    angles: Float[Tensor, "*batch 37"],
    measure: ColourMeasure = PAPER,
    quadrature: Quadrature = cell_visibility,
) -> Float[Tensor, "*batch P"]:
    """Visibility-weighted dissimilarity along every ray: equation 5 before the sum over pixels."""
    sigma, density, colour = (angles.new_tensor(a) for a in (body.sigma, body.density, body.colour))
    centres = pose_gaussians(body, angles)
    seen = quadrature(along_rays(centres, sigma, density, batch.origins, batch.directions))
    return (measure.compare(colour, batch.colours[..., None, :]) * seen).sum(-1)


def colour_energy(
    body: GaussianBody,
    batch: RayBatch,
    angles: Float[Tensor, "*batch 37"],
    measure: ColourMeasure = PAPER,
    quadrature: Quadrature = cell_visibility,
    chunk: int = 512,
) -> Float[Tensor, "*batch"]:
    """Sum over all rays of all views: equations 5, 6. `chunk` rays at a time bound the memory."""
    energies = (
        pixel_energy(body, batch[slice(i, i + chunk)], angles, measure, quadrature).sum(-1)
        for i in range(0, len(batch.origins), chunk)
    )
    return sum(energies, start=angles.new_zeros(()))


def colour_gradient(
    body: GaussianBody,
    batch: RayBatch,
    angles: Float[Tensor, "*batch 37"],
    measure: ColourMeasure = PAPER,
    quadrature: Quadrature = cell_visibility,
    chunk: int = 512,
) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch 37"]]:
    """`colour_energy` and its gradient by autograd, chunk by chunk, so that memory stays flat."""
    angles = angles.detach().requires_grad_(True)
    energy, gradient = angles.new_zeros(angles.shape[:-1]), torch.zeros_like(angles)
    for i in range(0, len(batch.origins), chunk):
        part = pixel_energy(body, batch[slice(i, i + chunk)], angles, measure, quadrature).sum(-1)
        gradient += torch.autograd.grad(part.sum(), angles)[0]
        energy += part.detach()
    return energy, gradient
