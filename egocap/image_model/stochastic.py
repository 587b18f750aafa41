"""Unbiased estimates of the colour energy and its gradient from few random pixels and Gaussians.

Rays are drawn by systematic sampling: the importances are laid end to end, and a comb of equally
spaced teeth with a random start picks the rays. Ray p is picked with probability
pi_p = min(1, S w_p / sum w) and counts 1 / pi_p times. The importance w is the pull that the
ray had on the pose when the sampler was aimed, mostly at the body's outline, on top of a
floor that every ray near the body has, so that no ray that matters is left out for good.

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
"""Share of the picks that go evenly to all rays near the body, wherever they pulled when aimed."""
STRAY = 0.02
"""Share that goes evenly to all rays of the images, where the body may move to."""


class PixelSampler:
    """Draws rays for an image model."""

    def __init__(self, model: ImageModel) -> None:
        self.model = model
        self._importance = np.ones(len(model.rays))

    def aim(self, colours: Float32[Array, "P 3"] | Palettes, angles: Float[Array, "37"]) -> None:
        """Set the importances by the rays' pulls at a pose: costs one full evaluation."""
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
        """Energy and gradient at a pose, right on average over the draws."""
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
    """Root mean square distance of estimated gradients from the full one, as a share of it."""
    exact = sampler.model.evaluate(angles, colours).gradient
    squared = [
        np.sum((sampler.estimate(colours, angles, count, keep, rng).gradient - exact) ** 2)
        for _ in range(draws)
    ]
    return float(np.sqrt(np.mean(squared)) / np.linalg.norm(exact))


@njit(cache=True)
def systematic(importance, count, start):
    """Picks (S,) and weights (S,) by a comb of `count` teeth that begins at `start` in [0, 1)."""
    step = importance.sum() / count
    picked, weights = np.empty(count + 1, np.int32), np.empty(count + 1, np.float32)
    tooth, passed, found = start * step, 0.0, 0
    for p in range(len(importance)):
        w = importance[p]
        passed += w
        if tooth < passed:
            picked[found], weights[found] = p, max(step / w, 1.0)
            found += 1
            while tooth < passed:  # a ray wider than the comb's step is picked once, for sure
                tooth += step
    return picked[:found], weights[:found]
