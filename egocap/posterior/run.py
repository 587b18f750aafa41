"""What `egocap posterior` does: one frame's posterior, as a file and as pictures."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from egocap.body.labels import LABELS
from egocap.data.detections import Detections
from egocap.data.sequence import Sequence
from egocap.errors import EgocapError, InputError
from egocap.files import make_folder
from egocap.posterior.config import PosteriorConfig, SamplerConfig
from egocap.posterior.measurement import check_frame
from egocap.posterior.result import Posterior, save_posterior

log = logging.getLogger(__name__)

CONTEXT = 10
"""Frames on either side that the tracker sees when it looks for a start."""


def sample_frame(
    sequence: Sequence,
    detections: Detections,
    frame: int,
    config: PosteriorConfig,
    sampling: SamplerConfig,
    checkpoint: Path | None = None,
    colour: bool = False,
) -> Posterior:
    """The posterior of one frame of a sequence; the tracker's pose is among its starts.

    With `colour`, the images speak beside the detections.
    """
    from egocap.posterior.log_prob import log_posterior_of
    from egocap.posterior.sampler import sample

    rig, person = sequence.rig, sequence.body
    check_frame(detections, frame, rig)
    sampling.walkers_for(37)  # refuse early
    said = None
    if colour:
        from egocap.posterior.colour import colour_likelihood

        said = colour_likelihood(sequence, detections, frame)
    density = log_posterior_of(detections, frame, rig, person, config, said)
    return sample(
        density, sampling, frame=frame, time_s=float(detections.times[frame]),
        source=detections.source, starts=_tracked(sequence, detections, frame),
        checkpoint=checkpoint,
    )  # fmt: skip


def write_posterior(
    sequence: Sequence,
    detections: Detections,
    frame: int,
    out: Path,
    config: PosteriorConfig,
    sampling: SamplerConfig,
    *,
    page: Path | None = None,
    checkpoint: Path | None = None,
    colour: bool = False,
) -> dict[str, Any]:
    """Sample, write the npz, and, when asked, the page of pictures. Returns a summary."""
    for path in (out, page, checkpoint):
        if path is not None:
            make_folder(path.parent)
    if page is not None and page.suffix not in (".html", ".htm"):
        raise InputError(f"--page {page}", valid="the name of an .html file")
    result = sample_frame(sequence, detections, frame, config, sampling, checkpoint, colour)
    save_posterior(out, result)
    if page is not None:
        from egocap.posterior.page import write_page

        write_page(page, result, sequence.rig, sequence.frame(frame).images)
    return summary(result)


def summary(result: Posterior) -> dict[str, Any]:
    """What to tell about a posterior, JSON-ready: spreads in mm, and how far to trust them."""
    spread = 1e3 * np.sqrt(np.trace(result.joint_covariance, axis1=1, axis2=2))
    laplace = 1e3 * np.sqrt(np.trace(result.laplace_joints, axis1=1, axis2=2))
    return {
        "frame": result.frame,
        "mixed": result.mixed,
        "outcome": result.outcome,
        "notes": list(result.notes),
        "steps": result.steps,
        "seconds": round(result.seconds, 1),
        "acceptance": round(result.acceptance, 3),
        "longest_autocorrelation": round(float(result.autocorrelation.max()), 1),
        "least_effective": round(float(result.effective.min())),
        "largest_rhat": round(float(result.rhat.max()), 4),
        "mode_shares": [round(float(share), 3) for share in result.mode_share],
        "spread_mm": {name: round(float(s), 1) for name, s in zip(LABELS, spread, strict=True)},
        "laplace_spread_mm": {
            name: round(float(s), 1) for name, s in zip(LABELS, laplace, strict=True)
        },
    }


def _tracked(sequence: Sequence, detections: Detections, frame: int) -> Any:
    """The tracker's pose of the frame as one more start (1, 37); None where it has none."""
    from egocap.track.tracker import track

    window = slice(max(0, frame - CONTEXT), frame + CONTEXT + 1)
    names = ("times", "points", "sigma", "confidence", "valid")
    part = replace(detections, **{name: getattr(detections, name)[window] for name in names})
    # Spreads that are not stated are the posterior's business.
    part = replace(part, sigma=np.where(part.sigma > 0, part.sigma, 1.0))
    try:
        angles = track(part, sequence.rig, sequence.body).angles
    except EgocapError as error:
        log.info("no start from the tracker: %s", error)
        return None
    return angles[frame - window.start][None]
