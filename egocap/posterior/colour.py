"""What a frame's images say of a pose beyond its detections: the colour energy as a likelihood.

    palette = learn_palette(body, rays, frames)                    # egocap.image_model.palette
    said = ColourLikelihood(ColourTerm(body, rig, palette), frame.images, pose)
    density = log_posterior_of(detections, frame_number, rig, proportions, extra=said)

or, in colours learned from a sequence's own track, `colour_likelihood(sequence, detections, 7)`.

It has no part in the search for modes, which goes by detections and prior. An evaluation takes a
millisecond, a hundred times as long as the detections': it is for single frames, in minutes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.data.detections import Detections
from egocap.data.sequence import Sequence as Footage
from egocap.image_model.colour_term import ColourTerm
from egocap.pose.config import TrackerConfig
from egocap.track.colour_refinement import learned_term


class ColourLikelihood:
    """Minus the colour term's energy of one frame, for many poses.

    The background is read off where the body at `pose` is not. The term must not see another frame
    while this is in use. Raises InputError for another number of images than of views.
    """

    def __init__(
        self,
        term: ColourTerm,
        images: Sequence[UInt8[Array, "H W 3"]],
        pose: Float[Array, "37"],
    ) -> None:
        self._term = term
        self._seen = term.see(images, pose)

    def __call__(self, angles: Float[Array, "W 37"]) -> Float[Array, "W"]:
        """Log likelihood of poses [rad], up to a constant."""
        model, weight = self._term.model, self._term.weight
        return np.array([-weight * model.evaluate(pose, self._seen).energy for pose in angles])


def colour_likelihood(footage: Footage, detections: Detections, frame: int) -> ColourLikelihood:
    """What the images of a frame say, in colours learned where the sequence's track is surest.

    Size and weight are those of the tracker's colour term. Raises InputError for pictures that are
    not of the rig's shape.
    """
    from egocap.track.tracker import track

    rig, person = footage.rig, footage.body
    found = track(detections, rig, person)
    assert found.covariance is not None
    term = learned_term(
        rig, person, TrackerConfig(follow_light=False), footage.images,
        found.angles, found.covariance.sum(axis=1),
    )  # fmt: skip
    return ColourLikelihood(term, footage.frame(frame).images, found.angles[frame])
