"""Refinement of every frame of a track by the colour term of its images.

The pose that detections, priors and motion gave and its covariance stand for all of them (Laplace's
approximation); a few damped Gauss-Newton steps minimise this Gaussian plus the colour term. The
person's colours are learned from the most certain frames of the track.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from egocap.body.proportions import Proportions
from egocap.cameras.rig import Rig
from egocap.image_model.colour_term import ColourTerm, ColourTermConfig, movable_angles
from egocap.pose.config import TrackerConfig

Images = Callable[[int], Sequence[UInt8[Array, "H W 3"]]]
"""RGB images of all views at a frame."""
PALETTE_FRAMES = 5
_STEPS = 3
_MAX_STEP = 0.3  # rad


def refine_by_colour(
    angles: Float[Array, "T 37"], covariances: Float[Array, "T 37 37"], seen: Bool[Array, "T 18"],
    term: ColourTerm, images: Images,
) -> tuple[Float[Array, "T 37"], Float[Array, "T 37 37"], Float[Array, "T"]]:  # fmt: skip
    """Refined angles, their covariances, and the colour energy of every frame.

    `seen` are the joints that were detected in any view; images move no others.
    """
    refined, narrowed = angles.copy(), covariances.copy()
    energies = np.zeros(len(angles))
    for t, start in enumerate(angles):
        term.set_images(images(t), start)
        precision = np.linalg.inv(covariances[t])
        refined[t], H, energies[t] = _refine_frame(start, precision, movable_angles(seen[t]), term)
        narrowed[t] = np.linalg.inv(H)
        term.update_illumination(refined[t])
    return refined, narrowed, energies


def _refine_frame(
    start: Float[Array, "37"], precision: Float[Array, "37 37"], movable: Bool[Array, "37"],
    term: ColourTerm,
) -> tuple[Float[Array, "37"], Float[Array, "37 37"], float]:  # fmt: skip
    """Angles, Gauss-Newton matrix and colour energy."""

    def evaluate(pose):
        away = pose - start
        H, g = precision.copy(), precision @ away
        colour = term.add(pose, H, g, movable)
        return 0.5 * away @ precision @ away + colour, colour, H, g

    pose, damping = start, 1e-3
    energy, colour, H, g = evaluate(pose)
    for _ in range(_STEPS):
        step = np.linalg.solve(H + damping * np.diag(np.diag(H)), -g)
        step *= min(1.0, _MAX_STEP / max(np.abs(step).max(), 1e-12))
        new, new_colour, new_H, new_g = evaluate(pose + step)
        if new < energy:
            pose, energy, colour, H, g = pose + step, new, new_colour, new_H, new_g
            damping *= 0.2
        else:
            damping *= 10.0
    return pose, H, colour


def learn_colour_term(
    rig: Rig, proportions: Proportions, config: TrackerConfig, images: Images,
    angles: Float[Array, "T 37"], covariances: Float[Array, "T N N"], seeing: Bool[Array, "T"],
) -> ColourTerm:  # fmt: skip
    """The colour term with the colours of the most certain frames of a track.

    Only frames that are `seeing` are taken: the others may lack a picture.
    Raises InputError for pictures that are not of the rig's shape.
    """
    rows = np.flatnonzero(seeing)
    chosen = rows[most_certain_frames(covariances[rows], PALETTE_FRAMES)]
    frames = [(images(int(t)), angles[t]) for t in chosen]
    settings = ColourTermConfig(size=config.colour_size, weight=config.colour_weight)
    return ColourTerm.learned(rig, proportions, frames, settings, config.adapt_illumination)


def most_certain_frames(covariances: Float[Array, "T N N"], count: int) -> list[int]:
    """The most certain frame of each of `count` stretches of a track."""
    variance = np.trace(covariances, axis1=1, axis2=2)
    edges = np.linspace(0, len(variance), min(count, len(variance)) + 1).astype(int)
    return [int(a + np.argmin(variance[a:b])) for a, b in pairwise(edges)]
