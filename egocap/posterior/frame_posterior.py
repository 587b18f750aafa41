"""The posterior of one frame of a sequence: density, starting poses and sampling put together."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.data.detections import Detections
from egocap.data.sequence import Sequence as Footage
from egocap.errors import EgocapError
from egocap.image_model.colour_term import ColourTerm
from egocap.pose.config import TrackerConfig
from egocap.posterior import sampler
from egocap.posterior.config import PosteriorConfig, SamplerConfig
from egocap.posterior.log_prob import LogLikelihood, make_log_posterior
from egocap.posterior.measurement import check_frame
from egocap.posterior.result import Posterior
from egocap.track.colour_refinement import learn_colour_term
from egocap.track.tracker import Tracker

log = logging.getLogger(__name__)

CONTEXT = 10
"""Frames on either side that are tracked to find a starting pose."""


def sample_posterior(
    sequence: Footage,
    frame: int,
    detections: Detections,
    config: PosteriorConfig = PosteriorConfig(),  # noqa: B008 (frozen)
    sampling: SamplerConfig = SamplerConfig(),  # noqa: B008 (frozen)
    *,
    checkpoint: Path | None = None,
    colour: bool = False,
    on_steps: sampler.OnSteps = lambda count: None,
) -> Posterior:
    """Sample the posterior of the pose in one frame of a sequence.

    The tracker's pose is one of the starting poses. With `colour` the likelihood includes the
    frame's images. With a `checkpoint` the chain is saved there and continued from it. A chain that
    did not converge is marked on the result; `on_steps` is called with the steps just made. Raises
    InputError, FileError.
    """
    check_frame(detections, frame, sequence.rig)
    images = learned_likelihood(sequence, detections, frame) if colour else None
    density = make_log_posterior(detections, frame, sequence.rig, sequence.body, config, images)
    return sampler.sample(
        density, sampling, frame=frame, time_s=float(detections.times[frame]),
        source=detections.source, starts=_tracked(sequence, detections, frame),
        checkpoint=checkpoint, on_steps=on_steps,
    )  # fmt: skip


def colour_likelihood(
    term: ColourTerm, images: Sequence[UInt8[Array, "H W 3"]], pose: Float[Array, "37"]
) -> LogLikelihood:
    """Log likelihood of poses given one frame's images: minus the colour term's weighted energy.

    The background is taken from where the body at `pose` is not. `term` must not be given another
    frame while the function is in use. An evaluation takes a millisecond, a hundred times as long
    as that of the detections. Raises InputError for another number of images than of views.
    """
    colours = term.set_images(images, pose)

    def log_likelihood(angles: Float[Array, "W 37"]) -> Float[Array, "W"]:
        return np.array([-term.weight * term.model.evaluate(a, colours).energy for a in angles])

    return log_likelihood


def learned_likelihood(sequence: Footage, detections: Detections, frame: int) -> LogLikelihood:
    """`colour_likelihood` of a frame, with colours learned where the sequence's track is surest.

    Image size and weight are those of the tracker's colour term. Raises InputError for images whose
    shape is not the rig's.
    """
    rig, person = sequence.rig, sequence.body
    found = Tracker(rig, person).track(detections)
    assert found.covariance is not None
    term = learn_colour_term(
        rig, person, TrackerConfig(adapt_illumination=False), sequence.images,
        found.angles, found.covariance.sum(axis=1), np.asarray(detections.valid.any(-1).all(-1)),
    )  # fmt: skip
    return colour_likelihood(term, sequence.frame(frame).images, found.angles[frame])


def _tracked(sequence: Footage, detections: Detections, frame: int) -> Float[Array, "1 37"] | None:
    """The tracker's pose of the frame; None where it finds none."""
    window = slice(max(0, frame - CONTEXT), frame + CONTEXT + 1)
    part = detections[window]
    # The tracker needs a spread; the posterior handles detections that state none.
    part = replace(part, sigma=np.where(part.sigma > 0, part.sigma, 1.0))
    try:
        angles = Tracker(sequence.rig, sequence.body).track(part).angles
    except EgocapError as error:
        log.info("no starting pose from the tracker: %s", error)
        return None
    return angles[frame - window.start][None]
