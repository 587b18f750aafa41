"""The images' say about a track: every frame's pose refined by colour, held by all the rest.

What detections, priors and motion say of a frame is summed up in the pose they gave and its
covariance (Laplace's approximation); the colour term joins that Gaussian, and a few damped
Gauss-Newton steps find the pose that both like. The person's colours are learned from the frames of
the track that are surest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from egocap.body.proportions import Proportions
from egocap.cameras.rig import Rig
from egocap.image_model.colour_term import ColourTerm, ColourTermConfig, felt_angles
from egocap.pose.config import TrackerConfig

Images = Callable[[int], Sequence[UInt8[Array, "H W 3"]]]
"""RGB images of all views at a frame."""
PALETTE_FRAMES = 5
_STEPS = 3
_LONGEST = 0.3  # rad a step


class ColourRefinement:
    """A person's colours, learned from a track, and what they add to it."""

    def __init__(
        self, rig: Rig, proportions: Proportions, config: TrackerConfig, images: Images,
        angles: Float[Array, "T 37"], covariances: Float[Array, "T 37 37"],
    ) -> None:  # fmt: skip
        self._term = learned_term(rig, proportions, config, images, angles, covariances)
        self._images = images

    def refine(
        self, angles: Float[Array, "T 37"], covariances: Float[Array, "T 37 37"],
        seen: Bool[Array, "T 18"],
    ) -> tuple[Float[Array, "T 37"], Float[Array, "T 37 37"], Float[Array, "T"]]:  # fmt: skip
        """Refined angles, their covariances, and the colour energy of every frame.

        `seen` tells which joints were detected in any view; the images move no others.
        """
        refined, narrowed = angles.copy(), covariances.copy()
        energies = np.zeros(len(angles))
        for t, start in enumerate(angles):
            self._term.see(self._images(t), start)
            held = np.linalg.inv(covariances[t])
            refined[t], H, energies[t] = self._frame(start, held, felt_angles(seen[t]))
            narrowed[t] = np.linalg.inv(H)
            self._term.settle(refined[t])
        return refined, narrowed, energies

    def _frame(
        self, start: Float[Array, "37"], held: Float[Array, "37 37"], felt: Bool[Array, "37"]
    ) -> tuple[Float[Array, "37"], Float[Array, "37 37"], float]:
        pose, damping = start, 1e-3
        energy, colour, H, g = self._sum(pose, start, held, felt)
        for _ in range(_STEPS):
            step = np.linalg.solve(H + damping * np.diag(np.diag(H)), -g)
            step *= min(1.0, _LONGEST / max(np.abs(step).max(), 1e-12))
            new, new_colour, new_H, new_g = self._sum(pose + step, start, held, felt)
            if new < energy:
                pose, energy, colour, H, g = pose + step, new, new_colour, new_H, new_g
                damping *= 0.2
            else:
                damping *= 10.0
        return pose, H, colour

    def _sum(self, pose, start, held, felt):
        away = pose - start
        H, g = held.copy(), held @ away
        colour = self._term.add(pose, H, g, felt)
        return 0.5 * away @ held @ away + colour, colour, H, g


def learned_term(
    rig: Rig, proportions: Proportions, config: TrackerConfig, images: Images,
    angles: Float[Array, "T 37"], covariances: Float[Array, "T N N"],
) -> ColourTerm:  # fmt: skip
    """The colour term of a person in the colours that the surest frames of a track show.

    Raises InputError for pictures that are not of the rig's shape.
    """
    frames = [(images(t), angles[t]) for t in surest_frames(covariances, PALETTE_FRAMES)]
    settings = ColourTermConfig(size=config.colour_size, weight=config.colour_weight)
    return ColourTerm.learned(rig, proportions, frames, settings, config.follow_light)


def surest_frames(covariances: Float[Array, "T N N"], count: int) -> list[int]:
    """The surest frame of every one of `count` stretches of a track."""
    spread = np.trace(covariances, axis1=1, axis2=2)
    edges = np.linspace(0, len(spread), min(count, len(spread)) + 1).astype(int)
    return [int(a + np.argmin(spread[a:b])) for a, b in pairwise(edges)]
