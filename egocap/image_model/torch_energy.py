"""The colour energy, readable: equations 5 and 6 of EgoCap over the rays of all views, in torch.

Batched over poses (frames or hypotheses) on any device, in either precision, differentiable. On a
GPU it evaluates many poses at once:

    device = torch_device("cuda")
    batch, measure = palette_batch(rays, palettes, torch.float32, device)
    energy, gradient = colour_gradient(body, batch, angles.to(batch.device, torch.float32), measure)

`Measure` is the dissimilarity of colours: the paper's (`colour_measure.PAPER`), or a person's
palette against the background (`palette_batch`), which the tracker uses.

`ReferenceModel` is called as the compiled `ImageModel` is, and is its oracle. When the kernel
leaves nothing out (`cutoff` 1e-5), its energy is within 2e-4 of this for every ray and its
derivatives within 0.1 % of the largest; with its usual cutoff, 3 % of the largest. The reference
takes seconds a pose; memory stays flat.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from jaxtyping import Float, Float32
from numpy import ndarray as Array
from torch import Tensor

from egocap.body.gaussians import GaussianBody
from egocap.errors import InputError, MachineError
from egocap.image_model.colour_measure import PAPER, ColourMeasure
from egocap.image_model.image_kernel import FIT_FLOOR
from egocap.image_model.image_rays import ImageRays
from egocap.image_model.kernel_arrays import Palettes
from egocap.image_model.model import Evaluation
from egocap.image_model.torch_visibility import (
    RayGaussians,
    along_rays,
    cell_visibility,
    pose_gaussians,
)

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
    def from_rays(
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
    """Rays whose colours are bins, and the measure that compares these; of `Background.compare`."""
    unlike = torch.as_tensor(palettes.unlike.T.copy(), dtype=dtype, device=device)
    return RayBatch.from_rays(rays, palettes.bins[:, None], dtype, device), PaletteMeasure(unlike)


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


class ReferenceModel:
    """`ImageModel` by torch and autograd, on any device and in either precision."""

    def __init__(
        self,
        body: GaussianBody,
        rays: ImageRays,
        measure: ColourMeasure = ColourMeasure(),  # noqa: B008 (frozen)
        dtype: torch.dtype = torch.float64,
        device: torch.device | str = "cpu",
        chunk: int = 512,
    ) -> None:
        self.body, self.rays, self.measure = body, rays, measure
        self.dtype, self.device, self.chunk = dtype, torch.device(device), chunk

    def batch(self, colours: Float32[Array, "P 3"] | Palettes) -> tuple[RayBatch, Measure]:
        """The rays with their colours on the device, and what compares these."""
        if isinstance(colours, Palettes):
            return palette_batch(self.rays, colours, self.dtype, self.device)
        return RayBatch.from_rays(self.rays, colours, self.dtype, self.device), self.measure

    def evaluate(
        self,
        angles: Float[Array, "37"],
        colours: Float32[Array, "P 3"] | Palettes,
        *,
        curvature: bool = False,
    ) -> Evaluation:
        """Energy, gradient and, on wish, Gauss-Newton matrix: see `ImageModel.evaluate`."""
        batch, measure = self.batch(colours)
        pose = torch.as_tensor(np.asarray(angles), dtype=self.dtype, device=self.device)
        energy, gradient = colour_gradient(self.body, batch, pose, measure, chunk=self.chunk)
        matrix = self._gauss_newton(pose, batch, measure) if curvature else None
        return Evaluation(energy.item(), gradient.cpu().numpy().astype(float), matrix)

    def _gauss_newton(self, pose: Tensor, batch: RayBatch, measure: Measure):
        """Sum over rays of J J^T / (2 (1 + e)): see `egocap.image_model.image_kernel`."""
        total = pose.new_zeros(len(pose), len(pose))
        for i in range(0, len(batch.origins), self.chunk):
            part = batch[slice(i, i + self.chunk)]
            with torch.no_grad():
                e = pixel_energy(self.body, part, pose, measure)
            J = torch.func.jacfwd(lambda a, part=part: pixel_energy(self.body, part, a, measure))(
                pose
            )
            total += J.T @ (J / (2.0 * (1.0 + e).clamp(min=FIT_FLOOR))[:, None])
        return total.cpu().numpy().astype(float)
