"""Bodies of simulated people, as the body prior has them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.commandline import progress
from egocap.fitting.body_prior import to_components
from egocap_sim.human.clothing.wardrobe import make_person
from egocap_sim.truth.proportions import measure_proportions

BODIES = range(340_000, 341_000)
"""Seeds of the people whose bones the prior is learned from."""


def proportions_of(seeds: Sequence[int]) -> Float[Array, "N K"]:
    """Components of the people of some seeds, as fractions of their statures."""
    shares = []
    with progress("people", len(seeds), unit="people") as advance:
        for person in map(make_person, seeds):
            shares.append(to_components(measure_proportions(person)) / person.height_m)
            advance(1)
    return np.array(shares)
