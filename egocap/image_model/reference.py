"""The image model in its readable form, called as the compiled one is: its oracle.

    fast, slow = ImageModel(body, rays), ReferenceModel(body, rays)
    slow.evaluate(angles, colours)      # the same numbers as fast.evaluate(angles, colours)

The kernel's energy is within 2e-4 of this for every ray and its derivatives within 0.1 % of the
largest, when it leaves nothing out (`cutoff` 1e-5); with its usual cutoff, 3 % of the largest.
Thousands of milliseconds a pose; memory stays flat.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Float32
from numpy import ndarray as Array
from torch import Tensor

from egocap.body.gaussians import GaussianBody
from egocap.image_model.appearance import (
    Measure,
    RayBatch,
    colour_gradient,
    palette_batch,
    pixel_energy,
)
from egocap.image_model.colour import ColourMeasure
from egocap.image_model.image_kernel import FIT_FLOOR, Palettes
from egocap.image_model.image_rays import ImageRays
from egocap.image_model.model import Evaluation


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
        return RayBatch.of(self.rays, colours, self.dtype, self.device), self.measure

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
