"""What is wrong with a rig file, told by the surroundings in a recording of the rig.

The odometry follows the first pictures that move with wide tolerances; the rig that explains them
best is compared with the file. A second pass, with that rig, is narrower.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.data.sequence import Sequence
from egocap.head_pose.pictures import grey_frames
from egocap.head_pose.wearer import WearerMasks
from egocap.odometry.config import OdometryConfig
from egocap.odometry.odometry import HeadPose, Odometry
from egocap.odometry.self_calibration import KEYFRAMES, NOISES_PX, Correction, find_correction
from egocap.odometry.views import Views

LONGEST = 450  # frames in which keyframes are sought


def find_rig_correction(
    sequence: Sequence,
    views: Views,
    config: OdometryConfig = OdometryConfig(),  # noqa: B008 (frozen)
    wearer: WearerMasks | None = None,
) -> Correction | None:
    """The correction of the views of a sequence; None where nothing is found to be wrong."""
    correction: Correction | None = None
    for noise_px in NOISES_PX:
        now = views if correction is None else correction.views
        odometry = Odometry(now, replace(config, noise_px=noise_px))
        for index, _ in followed(sequence, odometry, wearer):
            if len(odometry.map.keyframes) >= KEYFRAMES or index >= LONGEST:
                break
        correction = find_correction(odometry.map, views, correction)
        if correction is None:
            return None
    return correction


def followed(
    sequence: Sequence, odometry: Odometry, wearer: WearerMasks | None
) -> Iterator[tuple[int, HeadPose]]:
    """Frames of a sequence and their poses, one after the other."""
    for index, images in grey_frames(sequence, odometry.views.rig, range(len(sequence))):
        time = float(sequence.times[index])
        masks = () if wearer is None else wearer.at(time)
        yield index, odometry.add(index, time, images, masks, _late(sequence, index))


def _late(sequence: Sequence, index: int) -> Float[Array, "V"] | None:
    """Seconds from a frame's time to its pictures; None where they are of one instant."""
    times = sequence.frame_times
    if times is None:
        return None
    return np.where(times.present[index], times.taken[index] - times.time[index], 0.0)


def correction_lines(facts: dict[str, Any]) -> list[str]:
    """`Correction.facts` in words, a line for each view."""
    return [
        f"{view} corrected: turned by {found['rotation_deg']:.2f} degrees, moved by "
        f"{found['translation_mm']:.1f} mm, focal length {found['focal_percent']:+.2f} %, centre "
        f"by {found['centre_px']:.1f} px; lag {found['lag_ms']:.1f} ms, first to last row "
        f"{found['readout_ms']:.1f} ms"
        for view, found in facts.items()
    ]
