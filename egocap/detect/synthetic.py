"""Detections simulated from the truth: the source `simulated:SIGMA[,OPTION=VALUE...]`.

SIGMA alone gives independent Gaussian errors; the options add typical errors of learned detectors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from egocap.body.labels import LABEL_INDEX, MIRROR
from egocap.data.detections import Detections
from egocap.errors import InputError

FORM = (
    "simulated:SIGMA[,outliers=P][,occluded=keep|drop|guess][,spread=S][,tails=N]"
    "[,correlation=SECONDS][,overconfidence=F][,swaps=P][,wrong=P][,modes=P], SIGMA in pixels at "
    "640 x 512, P from 0 to 1, e.g. simulated:2.0 or simulated:2.0,outliers=0.1"
)
REFERENCE_WIDTH = 640
"""Image width [px] for which SIGMA is stated; it scales with the width."""
LEARNED_LIKE = (
    "simulated:3.0,outliers=0.02,occluded=guess,spread=0.5,tails=3,correlation=0.1,"
    "overconfidence=1.3,swaps=0.02,wrong=0.02,modes=0.7"
)
"""All error types of a learned detector, larger than those of the shipped one on people unseen in
training."""

GUESS = 5.0
"""Ratio of the errors of guessed joints to those of visible joints."""
SEEN_CONFIDENCE, GUESS_CONFIDENCE = 0.9, 0.2
EPISODE_S = 0.25
"""Mean duration of a left-right swap or a detection on another person's limb, seconds."""
_SWAPPED = (("shoulder", "elbow", "wrist", "hand"), ("hip", "knee", "ankle", "foot"))
_STRAY = tuple(
    tuple(LABEL_INDEX[f"{side}_{part}"] for part in parts)
    for side in ("left", "right")
    for parts in (("elbow", "wrist", "hand"), ("knee", "ankle", "foot"))
)
_STRAY_PX = (60.0, 200.0)  # distance of another person's limb, at the reference width


@dataclass(frozen=True)
class SimulatedSource:
    """Error model. Raises InputError for values out of range."""

    sigma: float  # scale of the error along each image axis, pixels at 640 x 512
    outliers: float = 0.0  # probability of an outlier for a joint not visible in a view
    occluded: Literal["drop", "keep", "guess"] = "drop"  # treatment of hidden joints in view
    spread: float = 0.0  # standard deviation of log sigma between joints and over time
    tails: int = 0  # degrees of freedom of Student's t; 0: Gaussian
    correlation: float = 0.0  # correlation time of errors, s; 0: independent frames
    overconfidence: float = 1.0  # ratio of true to stated sigma
    swaps: float = 0.0  # fraction of time with left and right swapped, legs or arms
    wrong: float = 0.0  # fraction of time on another person's limb
    modes: float = 0.0  # probability of a second mode at the truth of a confused joint

    def __post_init__(self) -> None:
        if not (math.isfinite(self.sigma) and 0.0 <= self.sigma <= REFERENCE_WIDTH):
            raise InputError(f"detections with sigma {self.sigma}", valid=FORM)
        for name in ("outliers", "swaps", "wrong", "modes"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InputError(f"detections with {name}={getattr(self, name)}", valid=FORM)
        if not (0.0 <= self.spread <= 3.0 and 0.0 <= self.correlation <= 60.0):
            raise InputError(f"detections with spread={self.spread}, "
                             f"correlation={self.correlation}", valid=FORM)  # fmt: skip
        if not (0.1 <= self.overconfidence <= 10.0 and 0 <= self.tails <= 1000):
            raise InputError(f"detections with overconfidence={self.overconfidence}, "
                             f"tails={self.tails}", valid=FORM)  # fmt: skip
        if self.occluded not in ("drop", "keep", "guess"):
            raise InputError(f"detections with occluded={self.occluded}", valid=FORM)

    def __str__(self) -> str:
        text = f"simulated:{self.sigma}"
        for option in fields(self)[1:]:
            value = getattr(self, option.name)
            text += f",{option.name}={value}" if value != option.default else ""
        return text


def parse_source(text: str) -> SimulatedSource:
    """Parse a source's name, e.g. "simulated:2.0". InputError lists the valid form."""
    kind, colon, rest = text.partition(":")
    if kind != "simulated" or not colon:
        raise InputError(f"unknown source of detections '{text}'", valid=FORM)
    sigma, *options = rest.split(",")
    kinds = {option.name: type(option.default) for option in fields(SimulatedSource)[1:]}
    values: dict[str, str] = {}
    for option in options:
        key, equals, value = option.partition("=")
        if key not in kinds or not equals or key in values:
            raise InputError(f"unknown or repeated option '{option}' in '{text}'", valid=FORM)
        values[key] = value
    try:
        read = {key: kinds[key](value) for key, value in values.items()}
        return SimulatedSource(float(sigma), **read)  # type: ignore[arg-type]
    except ValueError:
        raise InputError(f"not a number in '{text}'", valid=FORM) from None


class ProjectedJoints(NamedTuple):
    """True joints projected into the cameras."""

    points: Float[Array, "T V 18 2"]  # pixels
    visible: Bool[Array, "T V 18"]  # not hidden
    in_view: Bool[Array, "T V 18"]  # within the image, hidden or not
    times: Float[Array, "T"]  # seconds
    image_size: tuple[int, int] | Int[Array, "V 2"]  # width, height of all views or of each, pixels


def simulate_detections(
    joints: ProjectedJoints, source: SimulatedSource | str, rng: np.random.Generator
) -> Detections:
    """Draw detections around the true joints of every view.

    A visible joint (with occluded=keep: any joint in view) is detected at its true pixel plus
    noise, and missed if that is outside the image. With occluded=guess a hidden joint in view is
    detected with `GUESS` times the error and sigma and a low confidence. Any other joint is missed
    or, with probability `outliers`, detected at a uniform random position with the sigma and
    confidence of other detections. In random episodes left and right are swapped, or limbs of other
    people are detected; the true position may then be a second mode. Draws of noise and outliers
    depend on the generator state only, not on the source. Raises InputError for an invalid source.
    """
    joints_2d, visible, in_view, times, image_size = joints
    source = parse_source(source) if isinstance(source, str) else source
    shape = joints_2d.shape[:3]
    sizes = np.broadcast_to(image_size, (shape[1], 2))
    assert visible.shape == in_view.shape == shape, (visible.shape, in_view.shape, shape)
    scale = sizes[:, 0] / REFERENCE_WIDTH
    noise = rng.standard_normal((*shape, 2))
    wild_place = rng.random((*shape, 2)) * sizes[:, None] - 0.5
    wild_chance = rng.random(shape)

    visible = visible & in_view
    guessed = in_view & ~visible & (source.occluded == "guess")
    seen = in_view if source.occluded == "keep" else visible | guessed
    memory = _autocorrelation(times, source.correlation)
    sigma = source.sigma * scale[:, None] * np.where(guessed, GUESS, 1.0)
    if source.spread:
        level = _autoregression(rng.standard_normal(shape), memory)
        sigma = sigma * np.exp(source.spread * level)
    noise = _student_t(_autoregression(noise, memory), memory, source.tails, rng)
    honest = np.where(seen[..., None], joints_2d + sigma[..., None] * noise, wild_place)
    points, taken_for = _confused(honest, seen, times, scale, source, rng)
    sigma = np.take_along_axis(sigma, taken_for, 2)
    inside = _inside(points, sizes)
    present = np.take_along_axis(seen, taken_for, 2)
    valid = inside & (present | (wild_chance < source.outliers))
    guessed = np.take_along_axis(guessed, taken_for, 2)
    sure = np.where(guessed, GUESS_CONFIDENCE, SEEN_CONFIDENCE) if guessed.any() else 1.0
    modes, mode_weights = _modes(points, honest, valid, seen, sizes, source, rng)
    return Detections(
        times=np.asarray(times, float),
        points=np.where(valid[..., None], points, np.nan),
        sigma=sigma / source.overconfidence,
        confidence=np.where(valid, sure, 0.0),
        valid=valid,
        source=str(source),
        modes=modes,
        mode_weights=mode_weights,
    )


def _inside(points: Float[Array, "T V 18 2"], sizes: Int[Array, "V 2"]) -> Bool[Array, "T V 18"]:
    return np.all((points >= -0.5) & (points <= sizes[:, None] - 0.5), axis=-1)


def _autocorrelation(times: Float[Array, "T"], seconds: float) -> Float[Array, "T"]:
    """Correlation of every frame's error with the previous one; 0 for the first."""
    steps = np.diff(np.asarray(times, float), prepend=-np.inf)
    return np.exp(-steps / seconds) if seconds > 0 else np.zeros(len(steps))


def _autoregression(
    draws: Float[Array, "T *rest"], memory: Float[Array, "T"]
) -> Float[Array, "T *rest"]:
    """First-order autoregression of unit variance from independent draws."""
    if not memory.any():
        return draws
    made = draws.copy()
    for t in range(1, len(draws)):
        made[t] = memory[t] * made[t - 1] + np.sqrt(1.0 - memory[t] ** 2) * draws[t]
    return made


def _student_t(
    noise: Float[Array, "T V 18 2"], memory: Float[Array, "T"], tails: int,
    rng: np.random.Generator,
) -> Float[Array, "T V 18 2"]:  # fmt: skip
    """Student's t with the same autocorrelation: Gaussian over the root of a mean of squares."""
    if tails == 0:
        return noise
    squares = [
        _autoregression(rng.standard_normal(noise.shape[:3]), memory) ** 2 for _ in range(tails)
    ]
    return noise / np.sqrt(np.mean(squares, 0))[..., None]


def _confused(
    honest: Float[Array, "T V 18 2"], seen: Bool[Array, "T V 18"], times: Float[Array, "T"],
    scale: Float[Array, "V"], source: SimulatedSource, rng: np.random.Generator,
) -> tuple[Float[Array, "T V 18 2"], Array]:  # fmt: skip
    """Points after swaps and stray limbs, and the joint (T, V, 18) that each shows."""
    T, V = honest.shape[:2]
    shown = np.broadcast_to(np.arange(18), (T, V, 18)).copy()
    if source.swaps:
        for parts in _SWAPPED:
            labels = [LABEL_INDEX[f"{side}_{p}"] for side in ("left", "right") for p in parts]
            partners = [MIRROR[label] for label in labels]
            on = _episodes(times, V, source.swaps, rng)
            shown[..., labels] = np.where(on[..., None], partners, shown[..., labels])
    points = np.take_along_axis(honest, shown[..., None], 2)
    if source.wrong:
        for limb in _STRAY:
            on = _episodes(times, V, source.wrong, rng)
            away = rng.uniform(*_STRAY_PX, (T, V)) * scale
            angle = rng.uniform(0.0, 2.0 * np.pi, (T, V))
            shift = away[..., None] * np.stack([np.cos(angle), np.sin(angle)], -1)
            starts = on & ~np.roll(on, 1, axis=0)
            starts[0] = on[0]
            first = np.maximum.accumulate(np.where(starts, np.arange(T)[:, None], 0), axis=0)
            shift = np.take_along_axis(shift, first[..., None], 0)
            points[:, :, list(limb)] += np.where(on[..., None], shift, 0.0)[:, :, None]
    return points, shown


def _episodes(
    times: Float[Array, "T"], views: int, share: float, rng: np.random.Generator
) -> Bool[Array, "T V"]:
    """Two-state Markov chain: on for a fraction `share` of time, mean duration `EPISODE_S`."""
    chance = rng.random((len(times), views))
    steps = np.diff(np.asarray(times, float), prepend=times[0] if len(times) else 0.0)
    end = 1.0 - np.exp(-steps / EPISODE_S)
    begin = np.minimum(end * share / max(1.0 - share, 1e-9), 1.0)
    on = np.empty((len(times), views), bool)
    for t in range(len(times)):
        on[t] = (
            chance[t] < share if t == 0 else np.where(on[t - 1], chance[t] >= end[t],
                                                      chance[t] < begin[t])
        )  # fmt: skip
    return on


def _modes(
    points: Float[Array, "T V 18 2"], honest: Float[Array, "T V 18 2"],
    valid: Bool[Array, "T V 18"], seen: Bool[Array, "T V 18"], sizes: Int[Array, "V 2"],
    source: SimulatedSource, rng: np.random.Generator,
) -> tuple[Float[Array, "T V 18 2 2"] | None, Float[Array, "T V 18 2"] | None]:  # fmt: skip
    if not source.modes:
        return None, None
    elsewhere = (points != honest).any(-1) & seen & _inside(honest, sizes) & valid
    second = elsewhere & (rng.random(valid.shape) < source.modes)
    weights = np.stack([np.where(second, 0.6, 1.0) * valid, np.where(second, 0.4, 0.0)], -1)
    places = np.stack([points, honest], -2)
    return np.where(weights[..., None] > 0.0, places, np.nan), weights
