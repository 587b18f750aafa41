"""Unbiased estimates of the colour energy and its gradient from few random pixels and Gaussians.

Rays are drawn by systematic sampling: equally spaced positions with a random start along the
cumulative importances. Ray p is drawn with probability pi_p = min(1, S w_p / sum w) and weighs
1 / pi_p. The importance w is the length of the ray's gradient at the pose given to `aim`, plus a
floor for every ray near the body.

Source: EgoCap 2016, section 4.4; Blanz & Vetter 1999 (random pixels); systematic sampling as in
Saerndal, Swensson & Wretman, Model Assisted Survey Sampling, 1992, section 3.7.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float32, Int32
from numba import njit
from numpy import ndarray as Array

from egocap.image_model.kernel_arrays import Palettes
from egocap.image_model.model import Evaluation, ImageModel

FLOOR = 0.3
"""Fraction of the draws that is uniform over all rays near the body."""
STRAY = 0.02
"""Fraction that is uniform over all rays of the images, where the body may move to."""


class PixelSampler:
    """Draws rays for an image model."""

    def __init__(self, model: ImageModel) -> None:
        self.model = model
        self._importance = np.ones(len(model.rays))

    def aim(self, colours: Float32[Array, "P 3"] | Palettes, angles: Float[Array, "37"]) -> None:
        """Set the importances from the rays' gradients at a pose: costs one full evaluation."""
        energies, pull = self.model.pixel_energies(angles, colours)
        near = (energies != 0.0).astype(float)
        self._importance = (
            (1.0 - FLOOR - STRAY) * pull / max(pull.sum(), 1e-12)
            + FLOOR * near / max(near.sum(), 1.0)
            + STRAY / len(near)
        )

    def draw(
        self, count: int, rng: np.random.Generator
    ) -> tuple[Int32[Array, "S"], Float32[Array, "S"]]:
        """About `count` rays and how many times each counts."""
        return systematic(self._importance, count, rng.random())

    def estimate(
        self,
        colours: Float32[Array, "P 3"] | Palettes,
        angles: Float[Array, "37"],
        count: int,
        keep: float,
        rng: np.random.Generator,
    ) -> Evaluation:
        """Unbiased energy and gradient at a pose."""
        selected, weights = self.draw(count, rng)
        seed = int(rng.integers(2**63))
        return self.model.evaluate(
            angles, colours, selected=selected, weights=weights, keep=keep, seed=seed
        )


def gradient_scatter(
    sampler: PixelSampler,
    colours: Float32[Array, "P 3"] | Palettes,
    angles: Float[Array, "37"],
    count: int,
    keep: float,
    draws: int,
    rng: np.random.Generator,
) -> float:
    """Root mean square distance of estimated gradients from the full one, relative to it."""
    exact = sampler.model.evaluate(angles, colours).gradient
    squared = [
        np.sum((sampler.estimate(colours, angles, count, keep, rng).gradient - exact) ** 2)
        for _ in range(draws)
    ]
    return float(np.sqrt(np.mean(squared)) / np.linalg.norm(exact))


@njit(cache=True)
def systematic(importance, count, start):
    """Indices (S,) and weights (S,) of `count` systematic draws; `start` is in [0, 1)."""
    step = importance.sum() / count
    picked, weights = np.empty(count + 1, np.int32), np.empty(count + 1, np.float32)
    tooth, passed, found = start * step, 0.0, 0
    for p in range(len(importance)):
        w = importance[p]
        passed += w
        if tooth < passed:
            picked[found], weights[found] = p, max(step / w, 1.0)
            found += 1
            while tooth < passed:  # a ray longer than the step is drawn once
                tooth += step
    return picked[:found], weights[:found]
