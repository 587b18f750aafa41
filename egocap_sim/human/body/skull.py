"""The brain case: what hair, hats and headgear sit on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.core.bodies import INDEX
from egocap_sim.human.body.anny_model import BareBody, anatomy, skull_middle


@dataclass(frozen=True, eq=False)
class Skull:
    """An ellipsoid."""

    centre: Float[Array, "3"]  # of the brain case, world at rest
    half: Float[Array, "3"]  # half its length, width and height (m), without ears and nose


def skull_of(body: BareBody) -> Skull:
    """The brain case of a person."""
    head = body.vertices[anatomy().owner == INDEX["head"]]
    middle = skull_middle(head)
    crown = head[head[:, 2] > middle[2] + 0.2 * (head[:, 2].max() - middle[2])]
    low, high = crown.min(0), crown.max(0)
    centre = np.array([(low[0] + high[0]) / 2, 0.0, middle[2]])
    return Skull(centre, np.array([*(high - low)[:2] / 2, high[2] - middle[2]]))
