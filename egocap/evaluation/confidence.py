"""Whether a detector knows how good it is: its spread against its errors, its confidence against
what could be seen."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

LEVELS = (0.1, 0.25, 0.5, 0.68, 0.9, 0.95)
"""Shares of errors that a plane Gaussian has within the circles of `coverage`."""


def normalised_error(
    errors: Float[Array, "*axes"], sigma: Float[Array, "*axes"], counted: Bool[Array, "*axes"]
) -> float:
    """Root mean square of error / sigma along an axis: 1 for an honest sigma, above it for one too
    small. NaN when nothing is counted.

    `errors` are distances in the plane, `sigma` standard deviations along each axis, same unit.
    """
    ratio = _ratio(errors, sigma, counted)
    return float(np.sqrt(np.mean(ratio**2) / 2.0)) if ratio.size else float("nan")


def median_normalised_error(
    errors: Float[Array, "*axes"], sigma: Float[Array, "*axes"], counted: Bool[Array, "*axes"]
) -> float:
    """The same by the median of a plane Gaussian's distances, which gross errors do not move."""
    ratio = _ratio(errors, sigma, counted)
    return float(np.median(ratio) / np.sqrt(2.0 * np.log(2.0))) if ratio.size else float("nan")


def coverage(
    errors: Float[Array, "*axes"], sigma: Float[Array, "*axes"], counted: Bool[Array, "*axes"],
    level: float,
) -> float:  # fmt: skip
    """Share of errors within the circle that holds `level` of a plane Gaussian; ideally `level`."""
    ratio = _ratio(errors, sigma, counted)
    radius = np.sqrt(-2.0 * np.log(1.0 - level))
    return float(np.mean(ratio <= radius)) if ratio.size else float("nan")


def auroc(higher: Float[Array, "N"], lower: Float[Array, "M"]) -> float:
    """Chance that a draw from `higher` exceeds one from `lower`, ties counting half.

    NaN when either is empty. Source: Hanley and McNeil 1982 (area under the ROC curve as the
    Mann-Whitney statistic).
    """
    from scipy.stats import rankdata

    n, m = len(higher), len(lower)
    if not n or not m:
        return float("nan")
    ranks = rankdata(np.concatenate([higher, lower]))
    return float((ranks[:n].sum() - n * (n + 1) / 2.0) / n / m)


def reliability(
    probability: Float[Array, "N"], outcome: Bool[Array, "N"], bins: int = 10
) -> list[tuple[float, float, int]]:
    """Mean probability, share of true outcomes and count in equal bins from 0 to 1; empty ones left
    out."""
    which = np.minimum((np.asarray(probability) * bins).astype(int), bins - 1)
    rows = []
    for b in range(bins):
        inside = which == b
        if inside.any():
            share = float(np.mean(outcome[inside]))
            rows.append((float(np.mean(probability[inside])), share, int(inside.sum())))
    return rows


def calibration_error(
    probability: Float[Array, "N"], outcome: Bool[Array, "N"], bins: int = 10
) -> float:
    """Mean distance of probability and share over the bins of `reliability`, weighted by count."""
    rows = reliability(probability, outcome, bins)
    total = sum(count for _, _, count in rows)
    return sum(abs(p - s) * n for p, s, n in rows) / total if total else float("nan")


def _ratio(errors: Array, sigma: Array, counted: Array) -> Array:
    return np.asarray(errors, float)[counted] / np.maximum(np.asarray(sigma, float)[counted], 1e-9)
