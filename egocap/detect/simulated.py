"""Detections drawn from the truth: the named source `simulated:SIGMA[,outliers=P][,occluded=...]`.

It stands in for a detector whose error is known. It is the only detector that is handed truth, and
it hands on nothing but `Detections`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.errors import InputError
from egocap.results import Detections

FORM = (
    "simulated:SIGMA[,outliers=P][,occluded=keep|drop], SIGMA in pixels at 640 x 512, "
    "P from 0 to 1, e.g. simulated:2.0 or simulated:2.0,outliers=0.1"
)
REFERENCE_WIDTH = 640
"""Image width [px] at which SIGMA is stated; it grows in proportion to the image."""


@dataclass(frozen=True)
class SimulatedSource:
    """What to draw. Raises InputError for impossible values."""

    sigma: float  # standard deviation along each image axis, pixels at 640 x 512
    outliers: float = 0.0  # chance that a joint a view does not see gets a wild detection there
    occluded: Literal["drop", "keep"] = "drop"  # what becomes of joints in view but hidden

    def __post_init__(self) -> None:
        if not (math.isfinite(self.sigma) and 0.0 <= self.sigma <= REFERENCE_WIDTH):
            raise InputError(f"detections with sigma {self.sigma}", valid=FORM)
        if not 0.0 <= self.outliers <= 1.0:
            raise InputError(f"detections with outliers={self.outliers}", valid=FORM)
        if self.occluded not in ("drop", "keep"):
            raise InputError(f"detections with occluded={self.occluded}", valid=FORM)

    def __str__(self) -> str:
        text = f"simulated:{self.sigma}"
        if self.outliers:
            text += f",outliers={self.outliers}"
        return text + (",occluded=keep" if self.occluded == "keep" else "")


def parse_source(text: str) -> SimulatedSource:
    """Read a source's name, e.g. "simulated:2.0"; InputError lists the valid form."""
    kind, colon, rest = text.partition(":")
    if kind != "simulated" or not colon:
        raise InputError(f"unknown source of detections '{text}'", valid=FORM)
    sigma, *options = rest.split(",")
    values: dict[str, str] = {}
    for option in options:
        key, equals, value = option.partition("=")
        if key not in ("outliers", "occluded") or not equals or key in values:
            raise InputError(f"unknown or repeated option '{option}' in '{text}'", valid=FORM)
        values[key] = value
    try:
        numbers = float(sigma), float(values.get("outliers", "0"))
    except ValueError:
        raise InputError(f"not a number in '{text}'", valid=FORM) from None
    return SimulatedSource(*numbers, occluded=values.get("occluded", "drop"))  # type: ignore[arg-type]


def simulate_detections(
    joints_2d: Float[Array, "T V 18 2"],
    visible: Bool[Array, "T V 18"],
    in_view: Bool[Array, "T V 18"],
    times: Float[Array, "T"],
    image_size: tuple[int, int],
    source: SimulatedSource,
    rng: np.random.Generator,
) -> Detections:
    """Draw detections around the true joints of every view.

    A joint that a view sees (`visible`; with occluded=keep: `in_view`) is detected there at its
    true pixel plus Gaussian noise, and missed if the noise carries it out of the image. Any other
    joint is missed, or, with chance `outliers`, detected at a place drawn evenly from the image.
    Wild detections look like the others: same sigma, same confidence. `image_size` is (width,
    height) in pixels. The same generator state gives the same draws whatever the source's values.
    """
    shape = joints_2d.shape[:3]
    width, height = image_size
    assert visible.shape == in_view.shape == shape, (visible.shape, in_view.shape, shape)
    sigma = source.sigma * width / REFERENCE_WIDTH
    noise = rng.standard_normal((*shape, 2))
    wild_place = rng.random((*shape, 2)) * (width, height) - 0.5
    wild_chance = rng.random(shape)

    seen = in_view if source.occluded == "keep" else visible & in_view
    points = np.where(seen[..., None], joints_2d + sigma * noise, wild_place)
    inside = ((points >= -0.5) & (points <= (width - 0.5, height - 0.5))).all(-1)
    valid = inside & (seen | (wild_chance < source.outliers))
    return Detections(
        times=np.asarray(times, float),
        points=np.where(valid[..., None], points, np.nan),
        sigma=np.full(shape, sigma),
        confidence=np.where(valid, 1.0, 0.0),
        valid=valid,
        source=str(source),
    )
