"""Model of a detector's errors: heavy tails, scale by confidence, correlations.

In: errors of detections of footage with truth. Out: the detections and the settings with which the
posterior is calibrated. An error is the stated standard deviation, times a factor for its
confidence, times a Student-t variable. Errors of one frame are correlated between the
views and along limbs, which the likelihood leaves out; it is a composite likelihood, whose
temperature is the factor by which these correlations raise the variance of the angles. It follows
from the errors, not from the coverage. Correlation from frame to frame is stated; the posterior of
a single frame does not depend on it.

Source: Lange, Little & Taylor 1989 (t errors); Pauli, Racugno & Ventura 2011, "Bayesian composite
marginal likelihoods" (magnitude adjustment).
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from pydantic import Field

from egocap.data.detections import Detections
from egocap.files import write_json
from egocap.posterior.config import PosteriorConfig
from egocap.schema import Number, Strict, checked, read_json

log = logging.getLogger(__name__)

SHIPPED = Path(__file__).with_name("detector_error.json")
"""Of the shipped detector, by `egocap-eval calibration`."""
KIND = "egocap-detector-error"
EDGES = (0.1, 0.3, 0.6, 0.9)
"""Confidences between which the factor on the standard deviation is constant."""
_DEGREES = (2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0, 12.0, 20.0)
_FACTORS = np.geomspace(0.4, 4.0, 93)
_CLIP = 4.0
"""Standard deviations to which errors are clipped before moments are taken."""
_SHRINK = 0.1
"""Weight of independence in the estimated correlations."""


@dataclass(frozen=True)
class DetectorError:
    """What was learned about a detector's errors."""

    detector: str  # `Detections.source` of what it was learned from
    degrees: float  # of freedom of the Student-t errors
    factors: tuple[float, ...]  # on the stated standard deviation, between `EDGES`
    temperature: float
    memory: float  # correlation from each frame to the next
    frames: int

    def correct(self, detections: Detections) -> Detections:
        """The detections with standard deviations that hold."""
        which = np.searchsorted(EDGES, np.nan_to_num(detections.confidence))
        return replace(detections, sigma=detections.sigma * np.array(self.factors)[which])

    def configure(self, config: PosteriorConfig) -> PosteriorConfig:
        """The settings with this model's tails and temperature."""
        return replace(config, degrees=self.degrees, temperature=self.temperature)

    def save(self, path: str | Path) -> None:
        """Write the model as JSON."""
        write_json(Path(path), {"kind": KIND, **asdict(self)})


Factor = Annotated[Number, Field(ge=1e-3, le=1e3)]


class _File(Strict):
    kind: Literal["egocap-detector-error"]
    detector: str
    degrees: Number = Field(gt=2.0, le=1e6)
    factors: Annotated[tuple[Factor, ...], Field(min_length=5, max_length=5)]  # between `EDGES`
    temperature: Factor
    memory: Number = Field(ge=-1.0, le=1.0)
    frames: int = Field(ge=0)


def load_detector_error(path: str | Path = SHIPPED) -> DetectorError:
    """Read a model. Raises FileError."""
    data = checked(_File, read_json(path), path)
    return DetectorError(**data.model_dump(exclude={"kind"}))


def with_error_model(
    detections: Detections, config: PosteriorConfig
) -> tuple[Detections, PosteriorConfig]:
    """Detections and settings by the shipped model where it is of their detector, else as given."""
    model = load_detector_error()
    if detections.source != model.detector:
        return detections, config
    log.info("errors by the detector's model: %g degrees of freedom, temperature %g",
             model.degrees, model.temperature)  # fmt: skip
    return model.correct(detections), model.configure(config)


def learn_detector_error(
    detections: Sequence[Detections], truths: Sequence[Float[Array, "T V 18 2"]],
    sensitivity: Float[Array, "B V 18 2 37"], prior: Float[Array, "37 37"],
) -> DetectorError:  # fmt: skip
    """The model of some sequences' detections, given the true image points.

    `sensitivity` are derivatives of some poses' image points by the angles, in stated standard
    deviations, 0 where nothing was detected; `prior` is the precision of the angles beforehand.
    """
    errors, valid = [], []
    for found, truth in zip(detections, truths, strict=True):
        good = found.valid & np.isfinite(truth).all(-1) & (found.sigma > 0)
        away = np.where(good[..., None], found.points - truth, 0.0)
        errors.append(away / np.where(good, found.sigma, 1.0)[..., None])
        valid.append(good)
    error, good = np.concatenate(errors), np.concatenate(valid)
    confidence = np.concatenate([found.confidence for found in detections])
    which = np.searchsorted(EDGES, np.nan_to_num(confidence))
    degrees, factors = _tails(error, good, which)
    error = np.clip(error / factors[which][..., None], -_CLIP, _CLIP)
    starts = np.cumsum([0, *(len(e) for e in errors)])
    return DetectorError(
        detector=detections[0].source, degrees=degrees,
        factors=tuple(round(float(f), 3) for f in factors),
        temperature=round(_temperature(_correlation(error, good), sensitivity, prior), 2),
        memory=round(_memory(error, good, starts), 3), frames=len(error),
    )  # fmt: skip


def _tails(error: Array, good: Array, which: Array) -> tuple[float, Float[Array, "K"]]:
    """Degrees of freedom and factors of greatest likelihood."""
    squared = np.sum(error**2, axis=-1)
    best: tuple[float, float, Array] | None = None
    for nu in _DEGREES:
        total, factors = 0.0, np.ones(len(EDGES) + 1)
        for k in range(len(factors)):
            part = squared[good & (which == k)]
            if not len(part):
                continue
            loss = 0.5 * (nu + 2.0) * np.log1p(part[:, None] / _FACTORS**2 / (nu - 2.0))
            logs = -np.sum(loss + 2.0 * np.log(_FACTORS) + np.log1p(-2.0 / nu), axis=0)
            total, factors[k] = total + logs.max(), _FACTORS[logs.argmax()]
        if best is None or total > best[0]:
            best = total, nu, factors
    assert best is not None
    return best[1], best[2]


def _correlation(
    error: Float[Array, "T V 18 2"], good: Bool[Array, "T V 18"]
) -> Float[Array, "M M"]:
    """Correlation of a frame's errors (M = V 18 2), shrunk towards independence."""
    there = np.repeat(good.reshape(len(good), -1), 2, axis=1).astype(float)
    flat = error.reshape(len(error), -1) * there
    power = (flat**2).T @ there
    found = flat.T @ flat / np.sqrt(np.maximum(power * power.T, 1e-12))
    shrunk = (1.0 - _SHRINK) * found
    np.fill_diagonal(shrunk, 1.0)
    return shrunk


def _temperature(
    correlation: Float[Array, "M M"], sensitivity: Float[Array, "B V 18 2 37"],
    prior: Float[Array, "37 37"],
) -> float:  # fmt: skip
    """Mean variance of the angles with correlated errors over that with independent ones, of the
    part that the detections contribute; at least 1."""
    ratios = []
    for A in sensitivity.reshape(len(sensitivity), -1, sensitivity.shape[-1]):
        information = A.T @ A
        inverse = np.linalg.inv(information + prior)
        ratios.append(np.trace(inverse @ A.T @ correlation @ A) / np.trace(inverse @ information))
    return max(1.0, float(np.mean(ratios)))


def _memory(error: Array, good: Array, starts: Array) -> float:
    """Correlation of errors from each frame to the next, within sequences."""
    now, then = good[1:].copy(), good[:-1].copy()
    first = starts[1:-1] - 1  # pairs across sequences
    both = now & then
    both[first] = False
    a, b = error[1:][both], error[:-1][both]
    return float(np.sum(a * b) / max(0.5 * np.sum(a**2 + b**2), 1e-12))
