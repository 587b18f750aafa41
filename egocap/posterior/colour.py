"""What a frame's images say of a pose beyond its detections: the colour energy as a likelihood.

    palette = learn_palette(body, rays, frames)                    # egocap.track.palette
    said = ColourLikelihood(ColourTerm(body, rig, palette), frame.images, pose)
    density = log_posterior_of(detections, frame_number, rig, proportions, extra=said)

It has no part in the search for modes, which goes by detections and prior. An evaluation takes
milliseconds, hundreds of times as long as the detections': it is for single frames.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.track.colour_term import ColourTerm


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
