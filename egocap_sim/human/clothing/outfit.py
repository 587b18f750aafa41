"""Outfits by name: sampled from a generator, changed by the user, validated."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, fields, replace

import numpy as np

from egocap.errors import InputError
from egocap_sim.human.clothing.accessories import ACCESSORIES
from egocap_sim.human.clothing.fabric import PALETTE, PATTERNS, Fabric
from egocap_sim.human.clothing.garments import BOTTOMS, SOCKS, TOPS, UNDER_DRESSES
from egocap_sim.human.clothing.hair import HAIR_COLORS, HAIRCUTS
from egocap_sim.human.clothing.shoes import SHOES

BAREFOOT = "barefoot"
NO_SOCKS = "no_socks"
TOP_PATTERNS = {
    "plain": 5, "stripes": 4, "checks": 2, "gingham": 1, "dots": 1, "shapes": 2,
    "camouflage": 1, "marl": 2, "pinstripes": 1, "knit": 1, "gradient": 2,
}  # fmt: skip
WARM_PATTERNS = {"plain": 5, "knit": 3, "marl": 3, "stripes": 1, "checks": 1, "camouflage": 1}
BOTTOM_PATTERNS = {"denim": 5, "plain": 5, "marl": 2, "pinstripes": 1, "checks": 1, "camouflage": 1}
DENIM_COLORS = ("navy", "blue", "sky", "charcoal", "black", "grey")
BOTTOM_COLORS = (
    "black", "charcoal", "grey", "navy", "blue", "olive", "sand", "brown", "cream", "burgundy",
)  # fmt: skip
SHOE_COLORS = ("white", "black", "charcoal", "brown", "navy", "red", "grey", "sand", "green")
SOCK_COLORS = ("white", "white", "black", "charcoal", "grey", "navy", "red", "mustard", "green")
SOLE_COLORS = ("white", "black", "cream", "brown")
VALID: dict[str, Collection[str]] = {
    "top": TOPS, "bottom": BOTTOMS, "shoes": (*SHOES, BAREFOOT), "socks": (*SOCKS, NO_SOCKS),
    "sock_color": PALETTE, "hair": HAIRCUTS, "hair_color": HAIR_COLORS, "shoe_color": PALETTE,
    "sole_color": PALETTE, **{kind: ("none", *fits) for kind, fits in ACCESSORIES.items()},
}  # fmt: skip


@dataclass(frozen=True)
class Outfit:
    """Garments and fabrics by name; bare feet have no socks.

    Raises InputError for unknown names and impossible combinations.
    """

    top: str
    top_fabric: Fabric
    bottom: str
    bottom_fabric: Fabric
    shoes: str
    shoe_color: str
    sole_color: str
    socks: str
    sock_color: str
    hair: str
    hair_color: str
    gloves: str = "none"
    watch: str = "none"
    glasses: str = "none"
    hat: str = "none"

    def __post_init__(self) -> None:
        for kind, names in VALID.items():
            if (name := getattr(self, kind)) not in names:
                raise InputError(f"unknown {kind} '{name}'", valid=names)
        if TOPS[self.top].skirt is not None and self.bottom not in UNDER_DRESSES:
            raise InputError(
                f"'{self.bottom}' cannot be worn under a {self.top}", valid=UNDER_DRESSES
            )
        if TOPS[self.top].skirt is None and BOTTOMS[self.bottom] is None:
            raise InputError(
                "the bottom 'none' needs a dress",
                valid=[name for name, top in TOPS.items() if top.skirt is not None],
            )

    def describe(self) -> dict[str, object]:
        """The outfit as JSON-ready values."""
        table = asdict(self)
        for fabric in (table["top_fabric"], table["bottom_fabric"]):
            fabric["colors"] = list(fabric["colors"])
        return table


def sample_outfit(sex: str, age_years: float, tone: float, rng: np.random.Generator) -> Outfit:
    """Draw clothes, hair and accessories; hair colour depends on age and skin tone."""
    female = sex == "female"
    tops = {t: 1.0 if TOPS[t].skirt is None else 0.7 for t in TOPS}
    top = _weighted({t: w for t, w in tops.items() if female or TOPS[t].skirt is None}, rng)
    bottom = _bottom(top, female, rng)
    warm = ("sweater", "hoodie", "jacket", "zip_jacket", "vest")
    patterns = WARM_PATTERNS if top in warm else TOP_PATTERNS
    return Outfit(
        top=top,
        top_fabric=_fabric(patterns, tuple(PALETTE), rng),
        bottom=bottom,
        bottom_fabric=_fabric(BOTTOM_PATTERNS, BOTTOM_COLORS, rng),
        shoes=str(rng.choice([*SHOES, BAREFOOT], p=[0.45, 0.15, 0.18, 0.12, 0.1])),
        shoe_color=str(rng.choice(SHOE_COLORS)),
        sole_color=str(rng.choice(SOLE_COLORS)),
        socks=str(rng.choice([*SOCKS, NO_SOCKS], p=[0.4, 0.45, 0.15])),
        sock_color=str(rng.choice(SOCK_COLORS)),
        hair=_haircut(sex, rng),
        hair_color=_hair_color(age_years, tone, rng),
        gloves="gloves" if rng.uniform() < 0.08 else "none",
        watch="watch" if rng.uniform() < 0.3 else "none",
        glasses="glasses" if rng.uniform() < 0.3 else "none",
        hat=str(rng.choice(["none", *ACCESSORIES["hat"]], p=[0.76, 0.12, 0.06, 0.06])),
    )


def change_outfit(outfit: Outfit, changes: Mapping[str, str], hatless: bool = False) -> Outfit:
    """Replace parts of an outfit by name; fabrics as 'pattern:color[,color[,color]]'.

    A bottom that is not given is removed under a dress and added without one; a dress is replaced
    when a bottom is given. A `hatless` person wears headgear, so no hat. Raises InputError for
    unknown names and fields.
    """
    names = [field.name for field in fields(Outfit)]
    for key in changes:
        if key not in names:
            raise InputError(f"unknown part of an outfit '{key}'", valid=names)
    parsed = {
        key: _parse_fabric(str(value), getattr(outfit, key)) if "fabric" in key else str(value)
        for key, value in changes.items()
    }
    if hatless:
        if parsed.get("hat", "none") != "none":
            raise InputError("a hat cannot be worn under headgear", valid="hat = 'none'")
        parsed["hat"] = "none"
    if "bottom" not in parsed and parsed.get("top", outfit.top) in TOPS:
        is_dress = TOPS[str(parsed.get("top", outfit.top))].skirt is not None
        if is_dress and outfit.bottom not in UNDER_DRESSES:
            parsed["bottom"] = "none"
        elif not is_dress and BOTTOMS[outfit.bottom] is None:
            parsed["bottom"] = "trousers"
    elif (
        "top" not in parsed
        and TOPS[outfit.top].skirt is not None
        and parsed["bottom"] in set(BOTTOMS) - set(UNDER_DRESSES)
    ):
        parsed["top"] = "tshirt"
    return replace(outfit, **parsed)


def _parse_fabric(text: str, present: Fabric) -> Fabric:
    pattern, _, colors = text.partition(":")
    names = [c.strip() for c in colors.split(",") if c.strip()] or list(present.colors)
    if len(names) > 3:
        raise InputError(f"fabric '{text}' has {len(names)} colours", valid="1 to 3")
    names += [names[-1]] * (3 - len(names))
    return Fabric(pattern.strip(), (names[0], names[1], names[2]), present.wear)


def _fabric(
    patterns: Mapping[str, int], colors: tuple[str, ...], rng: np.random.Generator
) -> Fabric:
    assert set(patterns) <= set(PATTERNS)
    pattern = _weighted(patterns, rng)
    main = str(rng.choice(DENIM_COLORS if pattern == "denim" else colors))
    others = rng.choice([c for c in PALETTE if c != main], 2, replace=False)
    return Fabric(pattern, (main, str(others[0]), str(others[1])), round(float(rng.uniform()), 2))


def _bottom(top: str, female: bool, rng: np.random.Generator) -> str:
    """Draw a bottom: skirts for women only; leggings, tight shorts or none under a dress."""
    if TOPS[top].skirt is not None:
        return str(rng.choice(UNDER_DRESSES, p=[0.7, 0.22, 0.08]))
    usual = {"shorts": 20, "tight_shorts": 5, "slim_trousers": 25, "trousers": 30,
             "wide_trousers": 12, "leggings": 8}  # fmt: skip
    if female:
        usual |= {"skirt": 10, "pleated_skirt": 6, "long_skirt": 8}
    return _weighted(usual, rng)


def _haircut(sex: str, rng: np.random.Generator) -> str:
    usual = {"bald": 12, "buzz": 20, "short": 36, "thick": 22, "bob": 3, "long": 3,
             "very_long": 1, "ponytail": 3}  # fmt: skip
    if sex == "female":
        usual = {"bald": 1, "buzz": 2, "short": 15, "thick": 10, "bob": 20, "long": 24,
                 "very_long": 10, "ponytail": 18}  # fmt: skip
    return _weighted(usual, rng)


def _hair_color(age_years: float, tone: float, rng: np.random.Generator) -> str:
    if rng.uniform() < np.clip((age_years - 40) / 40, 0, 0.9):
        return str(rng.choice(["grey", "white"]))
    colors = [c for c in HAIR_COLORS if c not in ("grey", "white")]
    likely = np.array([3, 3, 2, 1, 1, 0.5]) * np.exp(-4 * tone * np.arange(6) / 5)
    return _weighted(dict(zip(colors, likely, strict=True)), rng)


def _weighted(weights: Mapping[str, float], rng: np.random.Generator) -> str:
    """One of the keys, drawn with these weights."""
    share = np.array(list(weights.values()), float)
    return str(rng.choice(list(weights), p=share / share.sum()))
