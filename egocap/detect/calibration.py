"""Calibration of the network's visibility and sigma, fitted on footage not used in training.

Confidence is a logistic function of the network's margin for "visible"; sigma is the network's
output times one factor for visible joints and another for hidden ones, each with its own for every
kind of joint.
Source: Platt 1999 (logistic scaling); Guo et al. 2017 (temperature).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.labels import LABELS, without_side
from egocap.errors import InputError

KINDS = tuple(dict.fromkeys(map(without_side, LABELS)))
LIMIT = 4.0  # bound of every |coefficient|; e^4 = 55
FEWEST = 50  # smallest number of joints to fit a coefficient
TYPICAL = 200
"""A kind of joint is fitted as if so many joints more had the errors of all kinds: single gross
errors make up much of a mean square."""


@dataclass(frozen=True)
class Calibration:
    """Coefficients. Raises InputError for values out of range."""

    scale: float = 1.0  # of the margin for "visible"
    offset: float = 0.0
    log_sigma_seen: float = 0.0  # added to log sigma
    log_sigma_hidden: float = 0.0
    kinds_seen: Mapping[str, float] = field(default_factory=dict)  # besides, by kind of joint
    kinds_hidden: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        values = asdict(self)
        for group in ("kinds_seen", "kinds_hidden"):
            if not isinstance(values[group], Mapping):
                raise InputError(f"a calibration with {group} {values[group]!r:.40}",
                                 valid="a number for each kind of joint")  # fmt: skip
            if unknown := sorted(set(values[group]) - set(KINDS)):
                raise InputError(f"a calibration with {group} of '{unknown[0]:.40}'", valid=KINDS)
            values |= {f"{group} {kind}": value for kind, value in values.pop(group).items()}
        for name, value in values.items():
            if not abs(value) <= (4 * LIMIT if name == "offset" else LIMIT):
                raise InputError(
                    f"a calibration with {name} {value:g}", valid=f"at most {LIMIT:g} either way"
                )

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready form: the fields."""
        return asdict(self)

    def confidence(self, info: Float[Array, "*n 18 4"]) -> Float[Array, "*n 18"]:
        """Visibility probability of each label."""
        return _logistic(self.scale * margin(info) + self.offset)

    def sigma(self, info: Float[Array, "*n 18 4"]) -> Float[Array, "*n 18"]:
        """Standard deviation along each axis, canonical pixels."""
        seen = self.confidence(info)
        factor = seen * self._log_factors[0] + (1.0 - seen) * self._log_factors[1]
        return np.exp(np.clip(np.asarray(info[..., 3], float) + factor, -8.0, 8.0))

    @cached_property
    def _log_factors(self) -> Float[Array, "2 18"]:
        """Added to log sigma of visible and of hidden joints, by label."""
        rows = (self.log_sigma_seen, self.kinds_seen), (self.log_sigma_hidden, self.kinds_hidden)
        return np.array([[overall + kinds.get(without_side(label), 0.0) for label in LABELS]
                         for overall, kinds in rows])  # fmt: skip


def margin(info: Float[Array, "*n 18 4"]) -> Float[Array, "*n 18"]:
    """Logit of VISIBLE against OCCLUDED and ABSENT together."""
    logits = np.asarray(info[..., :3], float)
    return logits[..., 0] - np.logaddexp(logits[..., 1], logits[..., 2])


def present(info: Float[Array, "*n 18 4"]) -> Bool[Array, "*n 18"]:
    """Whether a label is more probably in the view (visible or hidden) than absent."""
    logits = np.asarray(info[..., :3], float)
    return np.logaddexp(logits[..., 0], logits[..., 1]) > logits[..., 2]


def fit_calibration(
    info: Float[Array, "N 18 4"],
    errors: Float[Array, "N 18"],
    seen: Bool[Array, "N 18"],
    in_view: Bool[Array, "N 18"],
) -> Calibration:
    """Fit a calibration to the network's output on N annotated views.

    Confidence is fitted by maximum likelihood over joints in view. Each factor of sigma makes the
    root mean square of error / sigma along an axis 1 over its joints, visible or hidden, that are
    `present` in the output; other joints are never detections. A kind's factor is drawn towards
    that of all by `TYPICAL`.

    Args:
        info: output of the network, labels in either order (mirrored or the body's).
        errors: distance of each decoded point from the true one, canonical pixels.
        seen: joints visible to the camera.
        in_view: joints inside the view, visible or hidden.

    Raises:
        InputError: the views show fewer than `FEWEST` joints in view.
    """
    if int(in_view.sum()) < FEWEST:
        raise InputError(f"{int(in_view.sum())} joints to calibrate on", valid=f"{FEWEST} or more")
    scale, offset = _fit_logistic(margin(info)[in_view], seen[in_view])
    squared = 0.5 * np.square(errors / np.exp(np.clip(np.asarray(info[..., 3], float), -8.0, 8.0)))
    found = in_view & present(info)
    of_seen, of_hidden = (_log_factors(squared, found & which) for which in (seen, ~seen))
    return Calibration(scale, offset, of_seen[0], of_hidden[0], of_seen[1], of_hidden[1])


def _log_factors(
    squared: Float[Array, "N 18"], counted: Bool[Array, "N 18"]
) -> tuple[float, dict[str, float]]:
    """Half the logarithm of the mean over the joints that count, and what each kind adds to it.

    0 and nothing for fewer than `FEWEST` joints.
    """
    if counted.sum() < FEWEST:
        return 0.0, {}
    mean = squared[counted].mean()
    kinds = {}
    for kind in KINDS:
        columns = [without_side(label) == kind for label in LABELS]
        own = squared[:, columns][counted[:, columns]]
        share = (own.sum() / mean + TYPICAL) / (len(own) + TYPICAL)
        kinds[kind] = round(float(np.clip(0.5 * np.log(share), -LIMIT, LIMIT)), 4)
    return float(np.clip(0.5 * np.log(mean), -LIMIT, LIMIT)), kinds


def _fit_logistic(x: Float[Array, "N"], y: Bool[Array, "N"]) -> tuple[float, float]:
    """Maximum a posteriori slope and offset; the weak prior is centred at 1 and 0."""
    from scipy.optimize import minimize

    signs = np.where(y, 1.0, -1.0)

    def cost(p: Array) -> tuple[float, Array]:
        z = signs * (p[0] * x + p[1])
        slope = -_logistic(-z) * signs
        prior = np.array([p[0] - 1.0, p[1]])
        gradient = np.array([(slope * x).sum(), slope.sum()]) + prior
        return float(np.logaddexp(0.0, -z).sum() + 0.5 * prior @ prior), gradient

    bounds = [(0.05, LIMIT), (-4 * LIMIT, 4 * LIMIT)]
    found = minimize(cost, np.array([1.0, 0.0]), jac=True, bounds=bounds)
    return float(found.x[0]), float(found.x[1])


def _logistic(x: Float[Array, "*n"]) -> Float[Array, "*n"]:
    return 0.5 * (1.0 + np.tanh(0.5 * x))
