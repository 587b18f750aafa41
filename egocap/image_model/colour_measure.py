"""Dissimilarity of an image colour and a model colour: EgoCap's two-sided HSV measure.

Hue, saturation and value all lie in [0, 1]. Functions take numpy arrays or torch tensors.

Reading of the paper (appendix A), which prints two slips and leaves two things open:

- the blend's last summand is printed `w_g w_g`; it is `w_g d_g`, as the text above it says;
- phi(x) = 1 - (1 - x)^4 (8 x + 2) runs from -1 at 0 to 1 at 1, flat at both ends (its slope is
  40 x (1 - x)^3): it already is the two-sided energy, "d = 1 for dissimilar, -1 for similar";
- the blend may exceed 1 (d_d and d_g reach 2), where phi falls again to -17: it is held at 1;
- "all dimensions normalised to unit range" is taken to hold for the hue's angle, too: opposite hues
  are 1 apart. Were they 1/2 apart, red and cyan would count as alike (phi(1/4) = -0.27).

As the saturated part compares hues alone, and takes 100 degrees for the border between like and
unlike, a grey floor of a bluish tint is like a blue shirt. `ColourMeasure` therefore offers, beside
the paper's measure, the distance in the HSV cone, where a colour weighs as much as it is vivid.

Source: EgoCap 2016, appendix A; HSV cone: Smith 1978, "Color gamut transform pairs".
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Num
from numpy import ndarray as Array

from egocap.cameras.lens import namespace
from egocap.errors import InputError

SHADING = 0.5
"""Weight of brightness against colour in the cone: light and shade change it."""


@dataclass(frozen=True)
class ColourMeasure:
    """Dissimilarity of two colours, from -1 (alike) to 1 (unlike)."""

    kind: Literal["paper", "cone"] = "cone"
    """paper: appendix A; cone: squared distance in the HSV cone, brightness counting half."""
    reach: float = 0.2
    """Distance that counts as wholly unlike: in the cone; for paper, of hues in half turns."""

    def __post_init__(self) -> None:
        if self.kind not in ("paper", "cone"):
            raise InputError(f"no colour measure '{self.kind}'", valid=("paper", "cone"))
        if not 0.0 < self.reach <= 2.0:
            raise InputError(f"a colour reach of {self.reach}", valid="above 0, to 2")

    def features(self, hsv: Any) -> Any:
        """Colours (..., 3) as the measure compares them: HSV itself, or cone coordinates."""
        return hsv if self.kind == "paper" else cone(hsv)

    def compare(self, model_hsv: Any, image: Any) -> Any:
        """Dissimilarity of model colours in HSV and image colours as `features` gives them."""
        if self.kind == "paper":
            return dissimilarity(model_hsv, image, self.reach)
        return smooth_step(((cone(model_hsv) - image) ** 2).sum(-1) / self.reach**2)


PAPER = ColourMeasure("paper", 1.0)
"""The measure of appendix A."""


def rgb_to_hsv(rgb: Num[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
    """Hue, saturation, value in [0, 1] of 8-bit RGB, or of floating RGB in [0, 1].

    Greys have hue 0.
    """
    rgb = np.asarray(rgb)
    rgb = rgb / 255.0 if rgb.dtype == np.uint8 else rgb.astype(float)
    r, g, b = np.moveaxis(rgb, -1, 0)
    value = rgb.max(-1)
    chroma = value - rgb.min(-1)
    safe = np.where(chroma > 0, chroma, 1.0)
    sextant = np.where(
        value == r,
        ((g - b) / safe) % 6.0,
        np.where(value == g, (b - r) / safe + 2.0, (r - g) / safe + 4.0),
    )
    hue = np.where(chroma > 0, sextant / 6.0 % 1.0, 0.0)
    saturation = chroma / np.where(value > 0, value, 1.0)
    return np.stack([hue, saturation, value], -1)


def hsv_to_rgb(hsv: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
    """RGB in [0, 1] of hue, saturation, value in [0, 1]; undoes `rgb_to_hsv`."""
    hue, saturation, value = np.moveaxis(np.asarray(hsv, float), -1, 0)
    k = (np.array([5.0, 3.0, 1.0]) + 6.0 * hue[..., None]) % 6.0
    ramp = np.clip(np.minimum(k, 4.0 - k), 0.0, 1.0)
    return value[..., None] * (1.0 - saturation[..., None] * ramp)


def cone(hsv: Any) -> Any:
    """Coordinates in the HSV cone (..., 3): chroma along two axes, and weighted brightness."""
    xp = namespace(hsv)
    chroma, angle = hsv[..., 1] * hsv[..., 2], 2.0 * pi * hsv[..., 0]
    return xp.stack([chroma * xp.cos(angle), chroma * xp.sin(angle), SHADING * hsv[..., 2]], -1)


def smooth_step(x: Any) -> Any:
    """phi: -1 at 0, 1 from 1 on, flat at both ends."""
    x = _clip(x)
    return 1.0 - (1.0 - x) ** 4 * (8.0 * x + 2.0)


def hue_distance(a: Any, b: Any) -> Any:
    """Smaller angle between two hues, in half turns: 1 for opposite hues."""
    apart = abs(a - b)
    return 2.0 * namespace(apart).minimum(apart, 1.0 - apart)


def blend_weights(model: Any) -> tuple[Any, Any, Any]:
    """How saturated, dark and grey a model colour (..., 3) is; the three sum to 1."""
    xp = namespace(model)
    saturated = xp.sqrt(model[..., 1])
    dark, grey = _positive(0.5 - model[..., 2]), _positive(0.5 - model[..., 1])
    total = saturated + dark + grey
    return saturated / total, dark / total, grey / total


def dissimilarity(model: Any, image: Any, hue_reach: float = 1.0) -> Any:
    """d(m, i) in [-1, 1] of model and image HSV colours (..., 3), which broadcast.

    `hue_reach` is the angle at which hues count as wholly unlike, in half turns: 1 is the paper's.
    """
    saturated, dark, grey = blend_weights(model)
    d_value, d_saturation = model[..., 2] - image[..., 2], model[..., 1] - image[..., 1]
    d_saturated = _clip(hue_distance(model[..., 0], image[..., 0]) / hue_reach) ** 2
    d_dark = 2.0 * d_value**2
    d_grey = abs(d_value) + abs(d_saturation)
    return smooth_step(saturated * d_saturated + dark * d_dark + grey * d_grey)


def _clip(x: Any) -> Any:
    return x.clip(0.0, 1.0)


def _positive(x: Any) -> Any:
    return x.clip(0.0)
