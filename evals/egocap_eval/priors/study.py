"""Learn the tracker's priors from simulated people and the clips that they act out.

The body prior is the mean and scatter of their bones, as fractions of the stature; the pose prior,
the mean and covariance of the angles; the Gaussian motion prior, their covariances over time. The
motion network learns to correct tracks from the shipped detector's detections of rendered motions,
and from guessed ones. The attitude is that of the trunk in the head frame over whole recordings.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from tyro.conf import OmitArgPrefixes, Positional, arg

from egocap.consistency import attitude
from egocap.errors import InputError
from egocap.evaluation.table import Table
from egocap.fitting import body_prior
from egocap.pose import motion_network, motion_prior, pose_prior
from egocap_eval.harness.study import Outcome
from egocap_eval.priors.bodies import BODIES, proportions_of
from egocap_eval.priors.config import TrainingConfig
from egocap_eval.priors.takes import BUILT_IN, FPS, make_takes

Prior = Literal["body", "pose", "motion", "network", "attitude"]
_OF_CLIPS = "pose", "attitude"  # without built-in motions


def study(
    prior: Positional[Prior],
    folder: Positional[Annotated[Path | None, arg(metavar="DIR")]] = None,
    /,
    write: Annotated[Path | None, arg(metavar="FILE")] = None,
    work: Annotated[Path | None, arg(metavar="DIR")] = None,
    draws: int = 2,
    workers: int = 1,
    training: Annotated[TrainingConfig, OmitArgPrefixes] = TrainingConfig(),  # noqa: B008
) -> Outcome:
    """Learn a prior of the tracker: of bodies, poses, motion or attitude, or the motion network.

    Args:
        prior: Which prior to learn.
        folder: Folder of .bvh and .npz clips, searched recursively; optional for those of motion,
            which also learn from built-in motions; that of bodies needs none.
        write: File to write; by default the prior that the tracker uses.
        work: Folder that keeps takes and tracks: the same command continues from them.
        draws: Tracks from guessed detections of every take that the network learns from.
        workers: Rendering processes.
        training: How the network is trained.
    """
    if prior == "body":
        people = proportions_of(BODIES)
        learned = body_prior.learn_shares(people)
        body_prior.save_shares(learned, len(people), write or body_prior.FILE)
        return _of_bodies(learned)
    if folder is None and (prior in _OF_CLIPS or write is None):
        raise InputError("no folder of clips", valid="a folder; for a prior of built-in motions "
                         "alone, --write FILE")  # fmt: skip
    built_in = () if prior in _OF_CLIPS else BUILT_IN
    takes = make_takes(folder, built_in=built_in, keep=work and work / "takes")
    if prior == "network":
        from egocap_eval.priors.rendered import rendered_tracks
        from egocap_eval.priors.tracks import guessed_tracks
        from egocap_eval.priors.training import train_network

        keep = work and work / "tracks"
        tracks = rendered_tracks(folder, BUILT_IN, keep, workers)
        tracks += guessed_tracks(takes, draws, keep)
        network = train_network(tracks, training)
        motion_network.save_motion_network(network, write or motion_network.FILE)
        rows = [(t.name, len(t.angles), t.error_mm) for t in tracks]
        return _outcome("error_mm", "mean error mm", rows)
    motions = [take.angles for take in takes]
    if prior == "pose":
        pose_prior.save_posture(*pose_prior.learn_posture(motions), write or pose_prior.FILE)
    elif prior == "motion":
        learned = motion_prior.learn_motion_prior(motions, FPS)
        motion_prior.save_motion_prior(learned, write or motion_prior.FILE)
    else:
        learned = attitude.learn_attitudes([take.joints_head for take in takes])
        attitude.save_attitudes(learned, len(takes), write or attitude.FILE)
    rows = [(t.name, len(t.angles), t.fit_mm) for t in takes]
    return _outcome("fit_mm", "mean fit error mm", rows)


def _of_bodies(shares: body_prior.Shares) -> Outcome:
    percent = 100.0 * np.stack([shares.mean, np.linalg.norm(shares.directions, axis=0)], 1)
    rows = [{"component": f"{kind} {'xyz'[axis]}", "mean_percent": mean, "std_percent": std}
            for (kind, axis), (mean, std) in zip(body_prior.COMPONENTS, percent.round(3).tolist(),
                                                 strict=True)]  # fmt: skip
    cells = tuple((row["component"], f"{row['mean_percent']:.2f}", f"{row['std_percent']:.2f}")
                  for row in rows)  # fmt: skip
    table = Table("", ("component", "mean % of stature", "standard deviation"), cells)
    return Outcome({"components": rows}, [table])


def _outcome(key: str, heading: str, motions: list[tuple[str, int, float]]) -> Outcome:
    rows = [{"name": name, "frames": frames, key: error} for name, frames, error in motions]
    cells = tuple((name, str(frames), f"{error:.1f}") for name, frames, error in motions)
    return Outcome({"clips": rows}, [Table("", ("clip", "frames", heading), cells)])
