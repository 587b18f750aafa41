"""The colour energy, readable: equations 5 and 6 of EgoCap over the rays of all views, in torch.

Batched over poses (frames or hypotheses) on any device, in either precision, differentiable. The
oracle of `egocap.image_model.image_kernel`, and on a GPU the way to evaluate many poses at once:

    device = torch_device("cuda")
    batch, measure = palette_batch(rays, palettes, torch.float32, device)
    energy, gradient = colour_gradient(body, batch, angles.to(batch.device, torch.float32), measure)

How unlike colours are is a `Measure`: the paper's (`colour.PAPER`), or a person's palette against
the background (`palette_batch`), which is what the tracker uses.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import torch
from jaxtyping import Float
from torch import Tensor

from egocap.body.gaussians import GaussianBody
from egocap.errors import InputError, MachineError
from egocap.image_model.colour import PAPER
from egocap.image_model.image_rays import ImageRays
from egocap.image_model.torch_pose import pose_gaussians
from egocap.image_model.visibility import RayGaussians, along_rays, cell_visibility

if TYPE_CHECKING:
    from egocap.image_model.image_kernel import Palettes

Quadrature = Callable[[RayGaussians], Tensor]


class Measure(Protocol):
    """How unlike the Gaussians' colours and the rays' are, -1 to 1."""

    def compare(self, model_hsv: Any, image: Any) -> Any:
        """(*batch, P, G) from the Gaussians' (G, 3) and the rays' (*batch, P, 1, C)."""
        ...


def torch_device(name: str) -> torch.device:
    """The device "cpu", "cuda" or "cuda:N".

    Raises InputError for another name, MachineError when there is no such GPU.
    """
    kind, _, index = name.partition(":")
    if kind not in ("cpu", "cuda") or (index and not index.isdecimal()):
        raise InputError(f"no device '{name}'", valid=("cpu", "cuda", "cuda:N"))
    found = torch.cuda.device_count() if kind == "cuda" else 1
    if int(index or 0) >= found:
        raise MachineError(
            f"device '{name}': this PyTorch finds {found} GPUs",
            remedy="use the device 'cpu', or a machine and a PyTorch with CUDA",
        )
    return torch.device(name)


@dataclass(frozen=True)
class RayBatch:
    """Rays and their image colours, as the measure takes them; all on one device.

    Colours may have a batch axis of their own.
    """

    origins: Float[Tensor, "P 3"]
    directions: Float[Tensor, "P 3"]
    colours: Float[Tensor, "*batch P C"]

    @classmethod
    def of(
        cls,
        rays: ImageRays,
        colours: Any,
        dtype: torch.dtype = torch.float64,
        device: torch.device | str = "cpu",
    ) -> RayBatch:
        """Tensors of rays and of colours (..., P, C) along them."""
        origins, directions, features = (
            torch.as_tensor(a, dtype=dtype, device=device)
            for a in (rays.origins[rays.view], rays.direction, colours)
        )
        return cls(origins, directions, features)

    def __getitem__(self, rays) -> RayBatch:
        """Some of the rays."""
        return RayBatch(self.origins[rays], self.directions[rays], self.colours[..., rays, :])

    @property
    def device(self) -> torch.device:
        """Where the tensors are."""
        return self.origins.device

    def check_device(self, angles: Tensor) -> None:
        """Raises InputError when `angles` are elsewhere."""
        if angles.device != self.device:
            raise InputError(
                f"angles on {angles.device}, rays on {self.device}", valid="both on one device"
            )


@dataclass(frozen=True)
class PaletteMeasure:
    """Dissimilarities looked up by the bins of `egocap.image_model.palette`."""

    unlike: Float[Tensor, "K G"]

    def compare(self, model_hsv: Any, image: Float[Tensor, "*batch P 1 1"]) -> Tensor:
        """Dissimilarity of every Gaussian (*batch, P, G) to the bin that is each ray's colour."""
        return self.unlike[image[..., 0, 0].long()]


def palette_batch(
    rays: ImageRays,
    palettes: Palettes,
    dtype: torch.dtype = torch.float64,
    device: torch.device | str = "cpu",
) -> tuple[RayBatch, PaletteMeasure]:
    """Rays whose colours are bins, and the measure that compares these; of `Background.against`."""
    unlike = torch.as_tensor(palettes.unlike.T.copy(), dtype=dtype, device=device)
    return RayBatch.of(rays, palettes.bins[:, None], dtype, device), PaletteMeasure(unlike)


def pixel_energy(
    body: GaussianBody,
    batch: RayBatch,
    angles: Float[Tensor, "*batch 37"],
    measure: Measure = PAPER,
    quadrature: Quadrature = cell_visibility,
) -> Float[Tensor, "*batch P"]:
    """Visibility-weighted dissimilarity along every ray: equation 5 before the sum over pixels.

    Raises InputError when angles and rays are not on one device.
    """
    batch.check_device(angles)
    return _of_centres(body, batch, pose_gaussians(body, angles), measure, quadrature)


def colour_energy(
    body: GaussianBody,
    batch: RayBatch,
    angles: Float[Tensor, "*batch 37"],
    measure: Measure = PAPER,
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
    measure: Measure = PAPER,
    quadrature: Quadrature = cell_visibility,
    chunk: int = 512,
) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch 37"]]:
    """`colour_energy` and its gradient by autograd, chunk by chunk, so that memory stays flat.

    The chunks' derivatives by the Gaussians' centres are summed up and go through the skeleton
    once. Raises InputError when angles and rays are not on one device.
    """
    batch.check_device(angles)
    angles = angles.detach().requires_grad_(True)
    centres = pose_gaussians(body, angles)
    posed = centres.detach().requires_grad_(True)
    energy, by_centre = angles.new_zeros(angles.shape[:-1]), torch.zeros_like(posed)
    for i in range(0, len(batch.origins), chunk):
        part = _of_centres(body, batch[slice(i, i + chunk)], posed, measure, quadrature).sum(-1)
        by_centre += torch.autograd.grad(part.sum(), posed)[0]
        energy += part.detach()
    return energy, torch.autograd.grad(centres, angles, by_centre)[0]


def _of_centres(
    body: GaussianBody,
    batch: RayBatch,
    centres: Float[Tensor, "*batch G 3"],
    measure: Measure,
    quadrature: Quadrature,
) -> Float[Tensor, "*batch P"]:
    sigma, density, colour = (
        centres.new_tensor(a) for a in (body.sigma, body.density, body.colour)
    )
    seen = quadrature(along_rays(centres, sigma, density, batch.origins, batch.directions))
    return (measure.compare(colour, batch.colours[..., None, :]) * seen).sum(-1)
