"""Scores of 2-D body-part detections, or of a track projected back into the views."""

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
