"""What a track's images say against its detections: limbs found where the background shows.

A detector may find an arm that hangs out of sight in furniture beside it, surely and for seconds.
The pixels there do not have the sleeve's colours. So the body is drawn at the tracked poses, in the
colours that the surest frames teach, and every segment of a limb is asked whether its pixels are
more like itself or more like what lies behind the person: the log-likelihood ratio of
`egocap.image_model.palette`, summed over the pixels that it covers. Detections that led a
segment to where the images deny it count for nothing, and the motion is solved without them.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from egocap.body.labels import LABEL_INDEX, LABELS
from egocap.image_model.colour_term import ColourTerm
from egocap.pose.energy import angular_residual
from egocap.pose.observations import Observations
from egocap.track.colour_refinement import Images

EVERY_S = 0.1
"""Seconds from one frame that is looked at to the next; those between go with the nearest."""
EVIDENCE = 0.001
"""Evidence, in rays of a view that all speak clearly, that decides about a segment: of those within
40 mm of the truth one in thousands has so much against it."""
LED = 2.0
"""Standard deviations within which a joint lies of a detection that led it there."""
_CHAINS = tuple(
    tuple((LABEL_INDEX[f"{side}_{label}"], f"{side}_{part}") for label, part in chain)
    for side in ("left", "right")
    for chain in (
        (("elbow", "upper_arm"), ("wrist", "forearm"), ("hand", "hand")),
        (("knee", "thigh"), ("ankle", "shank"), ("foot", "foot")),
    )
)
"""Labels of each limb from the trunk outwards, and the part of the body that ends there."""


def denied(
    term: ColourTerm, images: Images, observations: Observations, angles: Float[Array, "T 37"]
) -> Bool[Array, "T 18"]:
    """Labels that the images of a track deny where its poses have them, frame by frame."""
    times, found = observations.times, observations.weights > 0.0
    usual = float(np.median(np.diff(times))) if len(times) > 1 else EVERY_S
    step = max(1, round(EVERY_S / usual))
    term.forget()
    asked = np.array([
        _against(term, images(t), angles[t], found[t]) for t in range(0, len(times), step)
    ])  # fmt: skip
    nearest = np.minimum((np.arange(len(times)) + step // 2) // step, len(asked) - 1)
    return _denied(asked)[nearest]


def without(
    observations: Observations, labels: Bool[Array, "T 18"], joints: Float[Array, "T 18 3"]
) -> tuple[Observations, int]:
    """Observations less those of some labels that led to where their joints are; and how many.

    In another view or mode a detector may have found the true place of the same label.
    """
    left, dropped = observations[:], 0
    for places in (left, left.modes):
        if places is not None:
            views = (1,) * (places.weights.ndim - labels.ndim)  # and modes
            off = angular_residual(
                joints.reshape(len(joints), *views, -1, 3), left.centres[:, None],
                places.rays, places.whiten,
            )  # fmt: skip
            led = (places.weights > 0.0) & (np.sum(off**2, axis=-1) < LED**2)
            led &= labels.reshape(len(labels), *views, -1)
            places.weights[led] = 0.0
            dropped += int(np.count_nonzero(led))
    return left, dropped


def _against(
    term: ColourTerm, images: Sequence[UInt8[Array, "H W 3"]], pose: Float[Array, "37"],
    found: Bool[Array, "V 18"],
) -> Float[Array, "18"]:  # fmt: skip
    """What the views in which a label was found have against its segment, in rays of a view."""
    palettes = term.see(images, pose)
    seen, view = term.visibility, term.model.rays.view
    assert seen is not None
    term.settle(pose)
    against = np.zeros(len(LABELS))
    parts = np.array(term.model.body.parts)
    for label, part in (entry for chain in _CHAINS for entry in chain):
        rays = found[view, label]
        for q in np.flatnonzero(parts == part):
            against[label] += seen[rays, q] @ palettes.unlike[q, palettes.bins[rays]]
    return against * len(found) / len(view)


def _denied(against: Float[Array, "A 18"]) -> Bool[Array, "A 18"]:
    """From what speaks against labels: those that are denied.

    Next to one that is denied for sure, in time or farther out on its limb, less is enough.
    """
    denied = against > EVIDENCE
    while True:
        more = denied.copy()
        more[1:] |= denied[:-1] & (against[1:] > 0.0)
        more[:-1] |= denied[1:] & (against[:-1] > 0.0)
        for chain in _CHAINS:
            for (inner, _), (outer, _) in pairwise(chain):
                more[:, outer] |= more[:, inner] & (against[:, outer] > -EVIDENCE)
        if np.array_equal(more, denied):
            return denied
        denied = more
