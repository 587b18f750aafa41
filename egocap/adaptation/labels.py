"""Labels of footage without annotations: where the offline tracker is sure a joint is.

The tracker knows more than the detector that it follows: the past and the future, the bones and the
other views. A joint whose place in the image it states within a few pixels becomes a label. Where
the detection agrees, the label is the mean of both by their precision; where it contradicts, the
tracked place holds only if another view's detection agrees with it. All other labels are UNKNOWN.
Pictures of footage are not all taken at their frames' times: labels are moved to the pictures'.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.data.footage import FrameTimes
from egocap.data.track import Track
from egocap.data.truth import OUT_OF_VIEW, VISIBLE
from egocap.detect.train.examples import HIDDEN, OUTSIDE, SEEN, UNKNOWN
from egocap.errors import InputError
from egocap.series import interpolate

SURE_PX = 6.0
"""Largest standard deviation of a label, pixels at an image width of 640."""
SURE = 0.6
"""Least probability of a joint to be within 5 cm."""
AGREES, CONTRADICTS = 2.0, 4.0
"""Distance of a detection from the tracked place, in standard deviations of both."""


@dataclass(frozen=True, eq=False)
class Labels:
    """Labels of every view."""

    points: Float[Array, "T V 18 2"]  # pixels; meaningless where OUTSIDE or UNKNOWN
    state: UInt8[Array, "T V 18"]  # SEEN, HIDDEN, OUTSIDE, UNKNOWN
    corrected: Bool[Array, "T V 18"]  # the detection was elsewhere

    @property
    def known(self) -> Bool[Array, "T V 18"]:
        """Labels with a place."""
        return self.state <= HIDDEN

    @property
    def in_view(self) -> Bool[Array, "T V 18"]:
        """Labels within the images, as tracked."""
        return self.state != OUTSIDE


def tracked_labels(track: Track, found: Detections, rig: Rig) -> Labels:
    """Labels of the frames of a track from these detections.

    Raises InputError for a track without covariance, or of another number of frames or views.
    """
    if track.covariance is None or track.confidence is None or track.hidden is None:
        raise InputError("a track without covariance", valid="one made with it")
    if track.hidden.shape != found.valid.shape or found.valid.shape[1] != len(rig.mounts):
        raise InputError(f"a track of {track.hidden.shape[:2]} frames and views with detections of "
                         f"{found.valid.shape[:2]}")  # fmt: skip
    places, J, inside = (np.moveaxis(a, 0, 1) for a in rig.project_jacobian(track.joints_head))
    spread = J @ track.covariance[:, None] @ np.swapaxes(J, -1, -2)
    variance = 0.5 * np.trace(spread, axis1=-2, axis2=-1)
    widths = np.array([camera.width for camera in rig.cameras], float)[:, None]
    sure = np.sqrt(variance) * 640.0 / widths <= SURE_PX
    sure &= (track.confidence >= SURE)[:, None]
    valid = found.valid & np.isfinite(found.points).all(-1) & (found.sigma > 0)
    detected = np.where(valid, np.square(np.where(valid, found.sigma, 1.0)), np.inf)
    off = np.where(valid[..., None], found.points - places, np.inf)
    distance = np.linalg.norm(off, axis=-1) / np.sqrt(variance + np.where(valid, detected, 1.0))
    agrees, contradicts = valid & (distance <= AGREES), valid & (distance > CONTRADICTS)
    elsewhere = agrees.sum(1, keepdims=True) - agrees > 0  # another view agrees
    sure &= agrees | elsewhere
    share = np.where(agrees, variance / (variance + detected), 0.0)
    points = places + share[..., None] * np.where(agrees[..., None], off, 0.0)
    state = np.where(track.hidden == VISIBLE, SEEN, HIDDEN)
    # A visible joint whose detection is elsewhere is not where the detector saw something.
    state = np.where(contradicts & (state == SEEN), HIDDEN, state)
    state = np.where(inside & (track.hidden != OUT_OF_VIEW), state, OUTSIDE)
    state = np.where(sure | (state == OUTSIDE), state, UNKNOWN).astype(np.uint8)
    return Labels(points, state, contradicts & (state <= HIDDEN))


def at_picture_times(labels: Labels, track: Track, rig: Rig, times: FrameTimes) -> Labels:
    """Labels at the times of the frames, moved to those at which the views' pictures were taken."""
    points = labels.points.copy()
    before, _ = rig.project(track.joints_head)
    for v in range(len(rig.mounts)):
        taken = np.where(times.present[:, v], times.taken[:, v], times.time)
        then, _ = rig.project(interpolate(taken, track.times, track.joints_head))
        points[:, v] += then[v] - before[v]
    return replace(labels, points=points)
