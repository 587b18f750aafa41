"""Prior over a person's bones: a Gaussian over proportions.

A person is symmetric and has 23 components: lengths of the bones that hang straight, vectors for
the others. As fractions of the stature they scatter together along `body_prior.json`'s directions,
and each on its own besides; the stature's standard deviation is common to all, so that one long
bone makes the others likely to be long. A given height narrows the stature.

Source: `body_prior.json`: bodies of the MakeHuman model (CC0) as `anny` poses them
(`egocap-eval learn-prior body`), as the joints that detectors mark are those of such bodies.
Stature: ANSUR II (Gordon et al. 2014), women and men together.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.labels import without_side
from egocap.body.proportions import Proportions
from egocap.body.skeleton import POINT_COUNT, POINT_INDEX, POINTS
from egocap.errors import FileError, InputError
from egocap.files import write_atomically
from egocap.schema import Number, Strict, checked, read_json

FILE = Path(__file__).with_name("body_prior.json")
STATURE_M, STATURE_SPREAD_M = 1.71, 0.10
HEIGHT_ERROR_M = 0.015
"""Standard deviation of a given height about the truth: shoes, the time of day."""
INDIVIDUAL = 0.035
"""Minimum relative standard deviation of a component at equal stature: that of limb segments in
ANSUR II; the bodies of a model differ less in some."""
OWN = 0.02
"""Minimum standard deviation of a component independently of all others, as a part of its bone:
people differ in more ways than the bodies of a model."""
DIRECTIONS = 12
"""Directions that are kept: of the bodies' variance, all but a thousandth."""

_AXES = {"head": "xz", "upper_spine": "xz", "lower_spine": "xz", "clavicle": "xyz",
         "shoulder": "xyz", "elbow": "z", "wrist": "z", "hand": "z", "hip": "xyz", "knee": "z",
         "ankle": "z", "foot": "xyz"}  # fmt: skip
COMPONENTS: tuple[tuple[str, int], ...] = tuple(
    (kind, "xyz".index(axis)) for kind, axes in _AXES.items() for axis in axes
)
"""Kind of point and axis of every free component."""


class _PriorFile(Strict):
    components: tuple[str, ...]
    people: int
    mean_percent: tuple[Number, ...]  # of the stature, as the directions
    directions_percent: tuple[tuple[Number, ...], ...]


@dataclass(frozen=True, eq=False)
class Shares:
    """Components as fractions of the stature: mean, and directions by their standard deviation."""

    mean: Float[Array, "K"]
    directions: Float[Array, "D K"]


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
        shares = load_shares()
        mean, directions = stature * shares.mean, stature * shares.directions
        together = directions.T @ directions
        lengths = np.linalg.norm(rest_offsets(mean), axis=1)
        bones = (BASIS.any(2) * lengths).max(1)  # those of the components
        own = np.maximum((INDIVIDUAL * mean) ** 2 - np.diag(together), (OWN * bones) ** 2)
        individual = together + np.diag(own)
        common = scatter**2 * np.outer(shares.mean, shares.mean)
        return cls(mean, common + individual, individual)


def learn_shares(people: Float[Array, "N K"]) -> Shares:
    """From the components of some people as fractions of their statures."""
    mean = people.mean(0)
    _, sizes, axes = np.linalg.svd((people - mean) / np.sqrt(len(people) - 1), full_matrices=False)
    return Shares(mean, (sizes[:, None] * axes)[:DIRECTIONS])


@cache
def load_shares(path: Path = FILE) -> Shares:
    """Read learned proportions. Raises FileError."""
    data = checked(_PriorFile, read_json(path), path)
    rows = (data.mean_percent, *data.directions_percent)
    if data.components != _NAMES or any(len(row) != len(_NAMES) for row in rows):
        raise FileError(path, "not for these components", key="components",
                        valid=f"{len(_NAMES)}: {', '.join(_NAMES)}")  # fmt: skip
    return Shares(np.array(rows[0]) / 100.0, np.array(rows[1:]).reshape(-1, len(_NAMES)) / 100.0)


def save_shares(shares: Shares, people: int, path: Path = FILE) -> None:
    """Write learned proportions, and of how many people they are."""
    mean, *rows = (json.dumps((100.0 * row).round(4).tolist())
                   for row in (shares.mean, *shares.directions))  # fmt: skip
    directions = ",\n  ".join(rows)
    write_atomically(path, (
        f'{{\n "components": {json.dumps(_NAMES)},\n "people": {people},\n'
        f' "mean_percent": {mean},\n "directions_percent": [\n  {directions}\n ]\n}}\n'
    ))  # fmt: skip


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

_NAMES = tuple(f"{kind} {'xyz'[axis]}" for kind, axis in COMPONENTS)
