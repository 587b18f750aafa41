"""Put a retargeted motion on the person's floor: height, and which feet stand."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.ndimage import gaussian_filter1d

from egocap_sim.bodies import BODIES, PARENTS
from egocap_sim.human.person import Person
from egocap_sim.human.soles import sole_points

_FLOOR_PERCENTILE = 8.0  # of the lowest sole's height: robust against a few low frames
_NEAR = 0.045  # metres: a lowest sole this close to the floor is standing on it
_DRIFT_S = 0.06  # standard deviation of the height correction over time, seconds
_PLANTED_HEIGHT = 0.03  # metres
_PLANTED_SPEED = 0.8  # metres a second


def plant(
    person: Person, root: Float[Array, "T 3"], turned: Float[Array, "T 21 3 3"], fps: float
) -> tuple[Float[Array, "T 3"], Float[Array, "T 21 3 3"], Bool[Array, "T 4"]]:
    """Correct the height of a motion so that standing soles lie on z = 0; say which feet stand.

    Returns root positions, body rotations and the planted feet (`egocap_sim.bodies.FEET`).
    """
    root = snap(person, root, turned, fps)
    return root, turned, planted(person, root, turned, fps)


def body_positions(
    person: Person, root: Float[Array, "T 3"], turned: Float[Array, "T 21 3 3"]
) -> Float[Array, "T 21 3"]:
    """Forward kinematics: joint positions of all bodies in the world, metres."""
    positions = np.empty((len(root), len(BODIES), 3))
    positions[:, 0] = root
    for b, parent in enumerate(PARENTS[1:], start=1):
        offset = person.joints[b] - person.joints[parent]
        positions[:, b] = positions[:, parent] + turned[:, parent] @ offset
    return positions


def snap(
    person: Person, root: Float[Array, "T 3"], turned: Float[Array, "T 21 3 3"], fps: float
) -> Float[Array, "T 3"]:
    """Shift the root vertically: one offset for the clip and a slow one while a foot is low."""
    heights = sole_points(person, body_positions(person, root, turned), turned)[..., 2]
    lowest = heights.min((1, 2))
    lowest = lowest - (offset := np.percentile(lowest, _FLOOR_PERCENTILE))
    near = np.abs(lowest) < _NEAR
    frames = np.arange(len(root))
    drift = np.interp(frames, frames[near], lowest[near]) if near.any() else np.zeros(len(root))
    drift = gaussian_filter1d(drift, _DRIFT_S * fps, mode="nearest")
    return root - np.outer(offset + drift, [0, 0, 1])


def planted(
    person: Person, root: Float[Array, "T 3"], turned: Float[Array, "T 21 3 3"], fps: float
) -> Bool[Array, "T 4"]:
    """Feet whose lowest sole point is near the floor and slow."""
    points = sole_points(person, body_positions(person, root, turned), turned)
    speed = np.linalg.norm(np.gradient(points, 1 / fps, axis=0), axis=-1)
    stands = (points[..., 2] < _PLANTED_HEIGHT) & (speed < _PLANTED_SPEED)
    return stands.any(-1)
