"""Learn the tracker's pose prior or motion prior from clips that simulated people act out.

Every clip is retargeted to a person and simulated; the tracker's angles are fitted to the joints,
observed without noise from four directions. The pose prior is the mean and covariance of the
angles; the motion prior, their covariances over time. The motion prior is also learned from
built-in motions, of other seeds, people and styles than any scene's.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from tyro.conf import Positional, arg

from egocap.body.proportions import Proportions
from egocap.body.skeleton import forward
from egocap.commandline import progress
from egocap.errors import EgocapError, InputError
from egocap.evaluation.table import Table
from egocap.geometry import inverse, transform, unit
from egocap.pose import kernel, motion_prior, pose_prior
from egocap.pose.config import TrackerConfig
from egocap.pose.observations import Observations, tangent_basis
from egocap.track import online_filter, smoother
from egocap_eval.harness.study import Outcome
from egocap_eval.sets.motion_sets import motion_sets
from egocap_eval.studies.physics import find_clips
from egocap_sim.core.bodies import INDEX
from egocap_sim.human.body.person import Person
from egocap_sim.human.clothing.wardrobe import make_person
from egocap_sim.motion.clips.load import load_clip
from egocap_sim.motion.generators.registry import make_motion
from egocap_sim.motion.kinematics.clip import Clip
from egocap_sim.motion.retarget.retarget import retarget
from egocap_sim.physics.simulation import simulate
from egocap_sim.truth.proportions import measure_proportions
from egocap_sim.truth.truth import label_positions

log = logging.getLogger(__name__)

UNNATURAL = ("005_",)
"""Clips with anatomically impossible foot directions."""
FPS, MAX_FRAMES = 30.0, 400
PEOPLE = {"pose": range(10, 16), "motion": range(310_000, 310_012)}
"""Seeds of the people who act out the clips in turn."""
FIRST_SEED = 320_000
SECONDS, SEQUENCE_SECONDS = 16.0, 40.0
BUILT_IN = (
    ["walk"] * 14 + ["gestures"] * 14 + ["sequence"] * 6
    + ["squat", "sit", "look_around", "idle", "dribble", "hold", "work", "juggle"] * 4
)  # fmt: skip
ACCURACY = 0.004  # rad
_EYES = np.array([[0.24, 0.18, 0.16], [0.24, -0.18, 0.16], [0.5, 0.0, -1.0], [-0.5, 0.8, -0.5]])
# Weak priors: the joints alone should determine the angles.
_CONFIG = TrackerConfig(lambda_posture=0.0, lambda_pose=0.02, acceleration_sigma=20.0)


def study(
    prior: Positional[Literal["pose", "motion"]],
    folder: Positional[Annotated[Path | None, arg(metavar="DIR")]] = None,
    /,
    write: Annotated[Path | None, arg(metavar="FILE")] = None,
) -> Outcome:
    """Learn the tracker's pose prior or motion prior from a folder of motions.

    Args:
        prior: Which prior to learn.
        folder: Folder of .bvh and .npz clips, searched recursively; optional for the motion prior.
        write: File to write; by default the prior that the tracker uses.
    """
    if prior == "pose" and folder is None:
        raise InputError("no folder of clips", valid="a folder for the pose prior")
    people = [make_person(seed) for seed in PEOPLE[prior]]
    clips, motions, rows = list(_clips(folder, built_in=prior == "motion")), [], []
    with progress("clips", len(clips), unit="clips") as advance:
        for clip, frames in clips:
            person = people[len(motions) % len(people)]
            advance()
            try:
                joints = simulated_joints(clip, person, frames)
            except EgocapError as error:
                log.warning("%s left out: %s", clip.name, error)
                continue
            proportions = measure_proportions(person)
            motions.append(fit_angles(joints, proportions))
            off = np.linalg.norm(forward(proportions, motions[-1]) - joints, axis=-1).mean()
            rows.append({"name": clip.name, "frames": len(joints), "fit_mm": 1e3 * float(off)})
    if prior == "pose":
        pose_prior.save_posture(*pose_prior.learn_posture(motions), write or pose_prior.FILE)
    else:
        learned = motion_prior.learn_motion_prior(motions, FPS)
        motion_prior.save_motion_prior(learned, write or motion_prior.FILE)
    cells = tuple((r["name"], str(r["frames"]), f"{r['fit_mm']:.1f}") for r in rows)
    return Outcome({"clips": rows}, [Table("", ("clip", "frames", "mean fit error mm"), cells)])


def fit_angles(
    joints_head: Float[Array, "T 18 3"], proportions: Proportions
) -> Float[Array, "T 37"]:
    """Angles that bring the tracker's skeleton closest to known joints (head frame, `FPS`)."""
    rays = unit(joints_head[:, None] - _EYES[None, :, None])
    whiten = tangent_basis(rays) / ACCURACY
    times = np.arange(len(rays)) / FPS
    observations = Observations(times, _EYES, rays, whiten, np.ones(rays.shape[:3]))
    model = kernel.make_model(proportions, _CONFIG)
    angles, _ = online_filter.filter_both_ways(observations, model, _CONFIG)
    return smoother.smooth_interval(angles, observations, model, _CONFIG)[0]


def simulated_joints(
    clip: Clip, person: Person, most_frames: int = MAX_FRAMES
) -> Float[Array, "T 18 3"]:
    """Joints of a person who acts out a clip, head frame, metres. Raises InputError."""
    reference = retarget(clip, person)
    frames = min(most_frames, int(reference.duration_s * FPS))
    bodies = simulate(person, reference, fps=FPS, n_frames=frames).T_world_body
    return transform(inverse(bodies[:, INDEX["head"]]), label_positions(person, bodies))


def _clips(folder: Path | None, built_in: bool) -> Iterator[tuple[Clip, int]]:
    """Motions to learn from, and the maximum number of frames to use of each."""
    for i, name in enumerate(BUILT_IN if built_in else ()):
        seconds = SEQUENCE_SECONDS if name == "sequence" else SECONDS
        clip = make_motion(name, seconds, np.random.default_rng(FIRST_SEED + i))
        yield clip, int(seconds * FPS)
    sets = motion_sets()
    for path in find_clips(folder) if folder else ():
        if sets.may_train(path) and not path.name.startswith(UNNATURAL):
            try:
                yield load_clip(path), MAX_FRAMES
            except EgocapError as error:
                log.warning("%s left out: %s", path.name, error)
