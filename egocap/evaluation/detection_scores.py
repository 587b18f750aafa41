"""Scores of 2-D detections: PCK, and the calibration of their sigma and confidence.

A track projected back into the views is scored by the same functions.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.labels import LABELS
from egocap.data.input_checks import require_finite, require_shape
from egocap.errors import InputError
from egocap.evaluation.metrics import auc, mean_error, pck, percentile, pixel_errors

THRESHOLD = 20.0  # pixels at 640 x 512
CURVE = tuple(float(t) for t in range(0, 31, 2))  # pixels at 640 x 512

DETECTION_PROTOCOL = "egocap-18: pixels at 640 x 512, all joints inside a view, missing ones missed"
"""Joints hidden by the wearer or by others count too, as the paper's projected labels do."""

LEVELS = (0.1, 0.25, 0.5, 0.68, 0.9, 0.95)
"""Levels of the confidence circles of `coverage`."""


@dataclass(frozen=True)
class DetectionScore:
    """Percentages of correct keypoints. None where nothing could be counted."""

    source: str
    pck20: float | None  # all joints inside the view, in percent
    auc20: float | None
    pck20_seen: float | None  # only those the camera sees: not hidden by the wearer or others
    auc20_seen: float | None
    mean_px: float | None  # of the joints found, at 640 x 512
    median_px: float | None
    missing_share: float | None  # share of counted joints without a detection
    counted: int  # joints x frames x views inside the view
    per_joint_pck20: Mapping[str, float | None]
    curve: Mapping[str, float | None]  # PCK at each threshold of `CURVE`
    protocol: str = DETECTION_PROTOCOL


def evaluate_detections(
    points: Float[Array, "T V 18 2"],
    detected: Bool[Array, "T V 18"],
    truth: Float[Array, "T V 18 2"],
    in_view: Bool[Array, "T V 18"],
    seen: Bool[Array, "T V 18"],
    image_widths: Float[Array, "V"],
    source: str = "",
) -> DetectionScore:
    """Score image points against the true ones.

    Args:
        points: predicted image points, pixels; read where `detected` only.
        detected: which of them exist.
        truth: true image points, pixels; read where `in_view` only.
        in_view: joints inside the image and the lens's field of view, hidden or not.
        seen: of these, the ones the camera actually sees.
        image_widths: width in pixels of each view's image, to bring errors to 640 x 512.
        source: how the points were made, for the report.

    Raises:
        InputError: shapes differ, or a point that is read is not finite.
    """
    require_shape(truth, ("T", "V", len(LABELS), 2), "true image points")
    for what, values in (("detections", points[..., 0]), ("detection flags", detected),
                         ("in-view flags", in_view), ("seen flags", seen)):  # fmt: skip
        if values.shape != truth.shape[:3]:
            raise InputError(
                f"{what} are of shape {values.shape}, the truth {truth.shape[:3]}",
                valid="the same frames, views and labels",
            )
    require_finite(points, "detections", detected)
    require_finite(truth, "true image points", in_view)
    seen = seen & in_view
    errors = pixel_errors(
        np.where(detected[..., None], points, 0.0),
        np.where(in_view[..., None], truth, 0.0),
        image_widths,
    )
    found = errors, detected
    measured = detected & in_view
    return DetectionScore(
        source=source,
        pck20=_number(pck(*found, in_view, THRESHOLD)),
        auc20=_number(auc(*found, in_view, THRESHOLD)),
        pck20_seen=_number(pck(*found, seen, THRESHOLD)),
        auc20_seen=_number(auc(*found, seen, THRESHOLD)),
        mean_px=_number(mean_error(errors, measured)),
        median_px=_number(percentile(errors, 50, measured)),
        missing_share=_number(mean_error(~detected, in_view)),
        counted=int(in_view.sum()),
        per_joint_pck20={
            name: _number(pck(errors[..., j], detected[..., j], in_view[..., j], THRESHOLD))
            for j, name in enumerate(LABELS)
        },
        curve={f"{t:g}": _number(pck(*found, in_view, t)) for t in CURVE},
    )


def _number(value: float) -> float | None:
    """None for 'nothing to measure': JSON has no NaN, and 0 would be a score."""
    return value if np.isfinite(value) else None


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
