"""Appearance check: rejects detections of limbs where the images show the background.

A detector may confuse an occluded arm with furniture beside it, for seconds and with confidence.
The body is drawn at the tracked poses, and for every segment of a limb the log-likelihood ratio of
the background's colours against its own (`egocap.image_model.palette`) is summed over the pixels
that it covers. Detections that led a rejected segment there are removed.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain, pairwise

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from egocap.body.labels import LABEL_INDEX, LABELS
from egocap.detect.input_images import ahead
from egocap.image_model.colour_term import ColourTerm
from egocap.pose.energy import angular_residual
from egocap.pose.observations import Observations
from egocap.track.colour_refinement import Images

CHECK_EVERY_S = 0.1
"""Seconds between checked frames; those between take the nearest one's result."""
EVIDENCE = 0.001
"""Summed log-likelihood ratio, in fully visible rays of a view, that rejects a segment: one of
thousands of segments within 40 mm of the truth exceeds it."""
GATE = 2.0
"""Standard deviations within which a detection is responsible for a joint's position."""
_CHAINS = tuple(
    tuple((LABEL_INDEX[f"{side}_{label}"], f"{side}_{part}") for label, part in limb)
    for side in ("left", "right")
    for limb in (
        (("elbow", "upper_arm"), ("wrist", "forearm"), ("hand", "hand")),
        (("knee", "thigh"), ("ankle", "shank"), ("foot", "foot")),
    )
)
"""Labels of each limb from the trunk outwards, and the part of the body that ends there."""
_PARTS = dict(chain.from_iterable(_CHAINS))
_SEGMENTS = np.array([_PARTS.get(label, "") for label in range(len(LABELS))])
"""The part of the body that ends at each label; empty for those of the trunk."""


def find_rejected(
    term: ColourTerm, images: Images, observations: Observations, angles: Float[Array, "T 37"]
) -> Bool[Array, "T 18"]:
    """Labels of every frame that the images contradict at the track's poses."""
    times, found = observations.times, observations.weights > 0.0
    usual = float(np.median(np.diff(times))) if len(times) > 1 else CHECK_EVERY_S
    step = max(1, round(CHECK_EVERY_S / usual))
    term.reset_background()
    evidence = np.zeros((len(times[::step]), len(LABELS)))
    rows = np.flatnonzero(found[::step].any(-1).all(-1))  # a view may lack its picture
    pictures = ahead(iter((rows * step).tolist()), images)
    for row, t, of_frame in zip(rows, rows * step, pictures, strict=True):
        evidence[row] = _evidence(term, of_frame, angles[t], found[t])
    nearest = np.minimum((np.arange(len(times)) + step // 2) // step, len(evidence) - 1)
    return _reject(evidence)[nearest]


def remove_rejected(
    observations: Observations, labels: Bool[Array, "T 18"], joints: Float[Array, "T 18 3"]
) -> tuple[Observations, int]:
    """Observations without those of rejected labels near their joints, and how many were removed.

    The same label in another view or mode may be correct and stays.
    """
    left, dropped = observations[:], 0
    for places in (left, left.modes):
        if places is not None:
            views = (1,) * (places.weights.ndim - labels.ndim)  # and modes
            off = angular_residual(
                joints.reshape(len(joints), *views, -1, 3), left.centres[:, None],
                places.rays, places.whiten,
            )  # fmt: skip
            led = (places.weights > 0.0) & (np.sum(off**2, axis=-1) < GATE**2)
            led &= labels.reshape(len(labels), *views, -1)
            places.weights[led] = 0.0
            dropped += int(np.count_nonzero(led))
    return left, dropped


def _evidence(
    term: ColourTerm, images: Sequence[UInt8[Array, "H W 3"]], pose: Float[Array, "37"],
    found: Bool[Array, "V 18"],
) -> Float[Array, "18"]:  # fmt: skip
    """Evidence against each label's segment from the views that detected it, in rays of a view."""
    palettes = term.set_images(images, pose)
    seen, view = term.visibility, term.model.rays.view
    assert seen is not None
    term.update_illumination(pose)
    unlike = seen * np.ascontiguousarray(palettes.unlike.T)[palettes.bins]  # (P, G)
    of_views = np.split(unlike, np.searchsorted(view, np.arange(1, len(found))))
    summed = np.array([rays.sum(0) for rays in of_views], float)
    own = np.array(term.model.body.parts)[:, None] == _SEGMENTS
    return np.einsum("vg,gl,vl->l", summed, own, found) * len(found) / len(view)


def _reject(evidence: Float[Array, "A 18"]) -> Bool[Array, "A 18"]:
    """Labels with enough evidence against them.

    Less is enough next to a rejected label, in time or farther out on its limb.
    """
    rejected = evidence > EVIDENCE
    while True:
        more = rejected.copy()
        more[1:] |= rejected[:-1] & (evidence[1:] > 0.0)
        more[:-1] |= rejected[1:] & (evidence[:-1] > 0.0)
        for limb in _CHAINS:
            for (inner, _), (outer, _) in pairwise(limb):
                more[:, outer] |= more[:, inner] & (evidence[:, outer] > -EVIDENCE)
        if np.array_equal(more, rejected):
            return rejected
        rejected = more
