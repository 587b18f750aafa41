"""Make a person from a seed: shape, skin, hair, clothes and headgear."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from numbers import Real

import numpy as np

from egocap.errors import InputError
from egocap_sim.assets.mesh import Actor
from egocap_sim.core.part_labels import OTHER_PERSON
from egocap_sim.human.body.anny_model import BareBody, anatomy, bare_body, landmarks
from egocap_sim.human.body.body_chart import make_chart
from egocap_sim.human.body.person import Person
from egocap_sim.human.body.phenotype import ADULT_YEARS, PHENOTYPE_NAMES, Phenotype, age_from_years
from egocap_sim.human.clothing.dressing import dress
from egocap_sim.human.clothing.headwear import HEADGEAR
from egocap_sim.human.clothing.outfit import change_outfit, sample_outfit

HEIGHTS_M = (1.40, 2.10)  # valid
SAMPLED_HEIGHTS_M = (1.50, 2.00)
SAMPLED_BMI = (18.0, 35.0)  # kg/m^2
SEXES = ("female", "male")
DENSITY = (1010.0, 985.0)  # kg/m^3 with air in the lungs, at phenotype weights 0 and 1
WORN = {"cap": {"hat": "cap"}, "glasses": {"glasses": "glasses"}}  # headgear that is an accessory
SHAPE, SKIN, OUTFIT, FABRIC, GEAR = range(5)  # random number streams of one seed


def make_person(
    seed: int,
    *,
    sex: str | None = None,
    height_m: float | None = None,
    age_years: float | None = None,
    skin_tone: float | None = None,
    phenotype: Mapping[str, float] | None = None,
    outfit: Mapping[str, str] | None = None,
    headgear: str | None = None,
    bystander: bool = False,
    name: str = "person",
) -> Person:
    """Make the person of a seed; the same arguments always give the same person.

    Values that are None are drawn from the seed. `sex` is 'female' or 'male'; `skin_tone` 0 (light)
    to 1 (dark); `phenotype` fixes values of `Phenotype` other than age and height (weight, muscle,
    proportions, gender, ...); `outfit` fixes parts of `Outfit` by name (top='hoodie',
    top_fabric='stripes:white,navy', shoes='barefoot', hair='bob', ...); `headgear` is None,
    'helmet', 'headset', 'cap' or 'glasses'. All vertices of a `bystander` have the part label of
    other people.

    Raises InputError, with the valid values, for invalid ones.
    """
    if not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"seed is {seed!r}", valid="an integer from 0")
    _check("headgear", headgear, (*HEADGEAR, *WORN))
    _check_range("skin_tone", skin_tone, (0.0, 1.0))

    shape_rng = _stream(seed, SHAPE)
    sex, years, body = _sample_body(shape_rng, sex, height_m, age_years, phenotype or {})
    tone = _tone(body.phenotype, _stream(seed, SKIN)) if skin_tone is None else float(skin_tone)
    clothes = sample_outfit(sex, years, tone, _stream(seed, OUTFIT))
    changes = _with_accessory(outfit or {}, headgear)
    over_hair = headgear if headgear in HEADGEAR else None
    clothes = change_outfit(clothes, changes, hatless=over_hair is not None)
    chart = make_chart(body)
    meshes = dress(chart, clothes, tone, over_hair, _stream(seed, FABRIC))
    if over_hair:
        meshes.append(HEADGEAR[over_hair](chart.skull, _stream(seed, GEAR)))
    if bystander:
        meshes = [replace(m, parts=np.full_like(m.parts, OTHER_PERSON)) for m in meshes]
    drawn = {
        "skin_tone": round(tone, 4),
        "outfit": clothes.describe(),
        "headgear": headgear,
    }
    return Person(
        name=name,
        height_m=body.height_m,
        mass_kg=_mass(body),
        joints=body.joints,
        landmarks=landmarks(body),
        body_vertices=body.vertices,
        body_owner=anatomy().owner,
        actor=Actor(name, tuple(meshes)),
        description={"seed": int(seed), **_describe(sex, years, body), **drawn},
    )


def _with_accessory(outfit: Mapping[str, str], headgear: str | None) -> dict[str, str]:
    """The outfit with the headgear, if that is part of it."""
    worn = WORN.get(headgear or "", {})
    for part, kind in worn.items():
        if outfit.get(part, kind) != kind:
            raise InputError(
                f"{part} '{outfit[part]}' with the headgear '{headgear}'",
                valid=f"{part} '{kind}', or headgear 'none'",
            )
    return {**outfit, **worn}


def _describe(sex: str, years: float, body: BareBody) -> dict[str, object]:
    return {
        "sex": sex,
        "age_years": round(years, 1),
        "height_m": round(body.height_m, 4),
        "mass_kg": round(_mass(body), 2),
        "phenotype": {k: round(v, 6) for k, v in asdict(body.phenotype).items()},
        "scale": round(body.scale, 6),
    }


def _stream(seed: int, purpose: int) -> np.random.Generator:
    return np.random.default_rng([int(seed), purpose])


def _sample_body(
    rng: np.random.Generator,
    sex: str | None,
    height_m: float | None,
    age_years: float | None,
    fixed: Mapping[str, float],
) -> tuple[str, float, BareBody]:
    """Sex, age and shape, drawn until the body mass index is plausible.

    The first draw is taken if weight or muscle is fixed.
    """
    _check("sex", sex, SEXES)
    _check_range("height_m", height_m, HEIGHTS_M)
    _check_range("age_years", age_years, ADULT_YEARS)
    free = [n for n in PHENOTYPE_NAMES if n not in ("age", "height")]
    for key, value in fixed.items():
        _check("phenotype", key, free)
        _check_range(f"phenotype {key}", value, (0.0, 1.0))
    drawn_sex = SEXES[int(rng.integers(2))]
    if sex is None and "gender" in fixed:
        sex = "female" if fixed["gender"] >= 0.5 else "male"
    sex = sex or drawn_sex
    drawn_years, drawn_height = rng.uniform(18.0, 75.0), rng.normal(0.0, 0.07)
    years = float(drawn_years if age_years is None else age_years)
    usual = 1.64 if sex == "female" else 1.77
    sampled = np.clip(usual + drawn_height, *SAMPLED_HEIGHTS_M)
    height = float(sampled if height_m is None else height_m)
    ancestry = dict(zip(("african", "asian", "caucasian"), rng.dirichlet([0.4] * 3), strict=True))
    gender = rng.uniform(0.0, 0.2)
    while True:
        values = {
            "gender": 1 - gender if sex == "female" else gender,
            "weight": 0.1 + 0.9 * rng.beta(2.0, 1.8),
            "muscle": 0.05 + 0.85 * rng.beta(1.6, 2.0),
            "proportions": rng.uniform(0.0, 0.7),
            "cup": rng.beta(2.0, 3.0),
            **ancestry,
            **{key: float(value) for key, value in fixed.items()},
        }
        shape = Phenotype(age=age_from_years(years), **{k: float(v) for k, v in values.items()})
        body = bare_body(shape, height)
        bmi = _mass(body) / body.height_m**2
        if SAMPLED_BMI[0] <= bmi <= SAMPLED_BMI[1] or {"weight", "muscle"} & fixed.keys():
            return sex, years, body


def _mass(body: BareBody) -> float:
    return body.volume_m3 * float(np.interp(body.phenotype.weight, [0, 1], DENSITY))


def _tone(shape: Phenotype, rng: np.random.Generator) -> float:
    """Draw a skin tone, 0 light to 1 dark, around the mean of an ancestry."""
    shares = np.array([shape.african, shape.asian, shape.caucasian])
    usual = float(shares @ [0.78, 0.42, 0.25] / shares.sum())
    return float(np.clip(usual + rng.normal(0, 0.13), 0.0, 1.0))


def _check(what: str, value: str | None, valid: Sequence[str]) -> None:
    if value is not None and value not in valid:
        raise InputError(f"unknown {what} '{value}'", valid=valid)


def _check_range(what: str, value: float | None, band: tuple[float, float]) -> None:
    if value is None:
        return
    if not isinstance(value, Real) or not band[0] <= value <= band[1]:
        raise InputError(f"{what} is {value!r}", valid=f"{band[0]:g} to {band[1]:g}")
