"""Shape parameters of an adult, and the blend-shape weights that follow from them."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.errors import InputError

YOUNG_YEARS, OLD_YEARS = 25.0, 90.0  # MakeHuman's ages of the young and the old shape
ADULT_YEARS = (18.0, 90.0)


@dataclass(frozen=True)
class Phenotype:
    """An adult's shape; every value from 0 to 1.

    Source: anny's parameters (MakeHuman's macro targets). The three ancestry values are shares,
    scaled to sum to one.
    """

    gender: float = 0.5  # 0 male, 1 female
    age: float = 0.25  # 0 is 25 years, 1 is 90
    muscle: float = 0.5
    weight: float = 0.5
    height: float = 0.5
    proportions: float = 0.5  # 0 ideal, 1 uncommon
    cup: float = 0.5
    african: float = 1 / 3
    asian: float = 1 / 3
    caucasian: float = 1 / 3

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if not 0.0 <= value <= 1.0:
                raise InputError(f"phenotype {name} is {value}", valid="0 to 1")
        if self.african + self.asian + self.caucasian <= 0:
            raise InputError("all three ancestry shares are 0", valid="at least one above 0")


PHENOTYPE_NAMES = tuple(field.name for field in fields(Phenotype))


def age_from_years(years: float) -> float:
    """Phenotype age from years; ages 18 to 25 have the same shape.

    Raises InputError outside 18 to 90.
    """
    low, high = ADULT_YEARS
    if not low <= years <= high:
        raise InputError(f"age is {years} years", valid=f"{low:g} to {high:g}")
    return float(np.clip((years - YOUNG_YEARS) / (OLD_YEARS - YOUNG_YEARS), 0.0, 1.0))


def corner_weights(p: Phenotype) -> dict[str, float]:
    """Weight of each corner of the shape space, by MakeHuman's name."""
    races = np.array([p.african, p.asian, p.caucasian])
    african, asian, caucasian = races / races.sum()
    return {
        "african": african, "asian": asian, "caucasian": caucasian,
        "male": 1 - p.gender, "female": p.gender,
        "young": 1 - p.age, "old": p.age,
        **_three(p.muscle, "minmuscle", "averagemuscle", "maxmuscle"),
        **_three(p.weight, "minweight", "averageweight", "maxweight"),
        "minheight": 1 - p.height, "maxheight": p.height,
        "idealproportions": 1 - p.proportions, "uncommonproportions": p.proportions,
        **_three(p.cup, "mincup", "averagecup", "maxcup"),
        "averagefirmness": 1.0,
    }  # fmt: skip


def blend_weights(p: Phenotype, corners: Array, mask: Bool[Array, "K C"]) -> Float[Array, "K"]:
    """Coefficient of each blend shape: the product of the weights of its corners."""
    table = corner_weights(p)
    weights = np.array([table.get(str(corner), 0.0) for corner in corners])
    return np.where(mask, weights, 1.0).prod(1)


def _three(value: float, low: str, middle: str, high: str) -> dict[str, float]:
    return {
        low: max(0.0, 1 - 2 * value),
        middle: 1 - abs(2 * value - 1),
        high: max(0.0, 2 * value - 1),
    }
