"""The wearer's proportions from the liveliest stretch of the footage itself."""

from __future__ import annotations

import numpy as np

from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.fitting.fit_body import BODY_PASSES, BodyFit, fit_body
from egocap.footage.sources import Step

SECONDS = 20.0


def fit_wearer(
    found: Detections, rig: Rig, height: float | None,
    on_step: Step = lambda name, total: lambda count: None,
) -> BodyFit:  # fmt: skip
    """Fit bone lengths to the 20 s in which the detections move most. Raises as `fit_body`."""
    part = found[liveliest(found)]
    advance = on_step("fit-body", BODY_PASSES * len(part.times))
    return fit_body(part, rig, height, on_frames=advance)


def liveliest(found: Detections) -> slice:
    """The 20 s in which detected points are spread most widely over the pictures."""
    times, T = found.times, len(found.times)
    length = min(T, max(round(SECONDS * (T - 1) / max(float(np.ptp(times)), 1e-6)), 1))
    starts = range(0, T - length + 1, max(length // 4, 1))

    def spread(start: int) -> float:
        part = found[start : start + length]
        points = np.where(part.valid[..., None], part.points, np.nan)
        counts = part.valid.sum(0)
        enough = counts > 0.3 * length
        return float(np.nanstd(points[:, enough], axis=0).sum()) if enough.any() else 0.0

    best = max(starts, key=spread)
    return slice(best, best + length)
