"""Occlusion of joints by cause: out of view, the wearer's own body, or another.

The tracked pose and the volumetric body predict the first two. Another cause is an object or a miss
of the detector: the two cannot be distinguished.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.body.gaussians import GaussianBody
from egocap.body.proportions import Proportions
from egocap.body.skeleton import forward
from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.data.truth import OCCLUDED, OUT_OF_VIEW, SELF_OCCLUDED, VISIBLE
from egocap.image_model.occlusion import DEPTH, optical_depths

DETECTED = 0.5
"""Confidence from which a joint counts as visible."""


def occlusion_causes(
    angles: Float[Array, "T 37"], detections: Detections, rig: Rig, proportions: Proportions
) -> UInt8[Array, "T V 18"]:
    """The cause for every joint in every view, in the codes of `egocap.data.track.HIDDEN`."""
    joints = np.ascontiguousarray(forward(proportions, angles))
    inside = np.moveaxis(rig.project(joints)[1], 0, 1)
    body = GaussianBody.from_proportions(proportions)
    behind = optical_depths(angles, joints, body, rig) >= DEPTH
    found = detections.valid & (np.nan_to_num(detections.confidence) >= DETECTED)
    cause = np.where(behind, SELF_OCCLUDED, OCCLUDED)
    cause = np.where(inside, cause, OUT_OF_VIEW)
    return np.where(found, VISIBLE, cause).astype(np.uint8)
