"""Takes: clips as simulated people act them out, in the tracker's angles.

Every clip is retargeted to a person and simulated; the tracker's angles are fitted to the joints,
observed without noise from four directions.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.proportions import Proportions
from egocap.body.skeleton import forward
from egocap.commandline import progress
from egocap.errors import EgocapError
from egocap.files import make_folder, read_npz, write_npz
from egocap.geometry import inverse, transform, unit
from egocap.pose import kernel
from egocap.pose.config import TrackerConfig
from egocap.pose.observations import Observations, tangent_basis
from egocap.track import online_filter, smoother
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
PEOPLE = range(310_000, 310_012)
"""Seeds of the people who act out the clips in turn."""
FIRST_SEED = 320_000
SECONDS = 400 / FPS
BUILT_IN = (
    *["walk"] * 5, *["gestures"] * 5, "sequence", "sequence",
    *["squat", "sit", "look_around", "idle", "dribble", "hold", "work", "juggle"],
)  # fmt: skip
"""Motions of the simulator, of other seeds, people and styles than any scene's."""
ACCURACY = 0.004  # rad
_EYES = np.array([[0.24, 0.18, 0.16], [0.24, -0.18, 0.16], [0.5, 0.0, -1.0], [-0.5, 0.8, -0.5]])
# Weak priors: the joints alone should determine the angles.
_CONFIG = TrackerConfig(lambda_posture=0.0, lambda_pose=0.02, acceleration_sigma=20.0)


@dataclass(frozen=True, eq=False)
class Take:
    """A motion of a person at `FPS`."""

    name: str
    angles: Float[Array, "T 37"]  # rad
    joints_head: Float[Array, "T 18 3"]  # m
    T_world_head: Float[Array, "T 4 4"]
    offsets: Float[Array, "22 3"]  # of the person's skeleton, m

    @property
    def person(self) -> Proportions:
        """The person's proportions."""
        return Proportions(self.offsets)

    @property
    def fit_mm(self) -> float:
        """Mean distance of the tracker's skeleton from the joints, mm."""
        away = forward(self.person, self.angles) - self.joints_head
        return 1e3 * float(np.linalg.norm(away, axis=-1).mean())


def make_takes(folder: Path | None, *, built_in: Sequence[str], keep: Path | None) -> list[Take]:
    """Takes of the clips of a folder that may be learned from, and of built-in motions.

    Those in the folder `keep` are read from there, the others written to it. Clips that cannot be
    acted out are left out with a warning. Raises FileError.
    """
    takes, clips = [], list(clips_of(folder, built_in))
    with progress("takes", len(clips), unit="takes") as advance:
        for i, (name, path) in enumerate(clips):
            kept = None if keep is None else keep / f"{name}.npz"
            try:
                takes.append(_make(name, path, i, kept))
            except EgocapError as error:
                log.warning("%s left out: %s", name, error)
            advance()
    return takes


def _make(name: str, path: Path | None, index: int, kept: Path | None) -> Take:
    if kept is not None and kept.is_file():
        found = read_npz(kept)
        return Take(name, found["angles"], found["joints"], found["T_world_head"], found["offsets"])
    take = act_out(name, _load(name, path, index), _person(PEOPLE[index % len(PEOPLE)]))
    if kept is not None:
        make_folder(kept.parent)
        write_npz(
            kept, angles=take.angles, joints=take.joints_head, T_world_head=take.T_world_head,
            offsets=take.offsets,
        )  # fmt: skip
    return take


def act_out(name: str, clip: Clip, person: Person) -> Take:
    """The first `MAX_FRAMES` frames of a clip, acted out by a person. Raises InputError."""
    reference = retarget(clip, person)
    frames = min(MAX_FRAMES, int(reference.duration_s * FPS))
    bodies = simulate(person, reference, fps=FPS, n_frames=frames).T_world_body
    T_world_head = bodies[:, INDEX["head"]]
    joints = transform(inverse(T_world_head), label_positions(person, bodies))
    proportions = measure_proportions(person)
    angles = fit_angles(joints, proportions)
    return Take(name, angles, joints, T_world_head, np.asarray(proportions.offsets))


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


@lru_cache(maxsize=len(PEOPLE))
def _person(seed: int) -> Person:
    return make_person(seed)


def clips_of(folder: Path | None, built_in: Sequence[str]) -> Iterator[tuple[str, Path | None]]:
    """Names of the motions that may be learned from, and the file of each that is recorded."""
    for i, name in enumerate(built_in):
        yield f"builtin-{name}-{i}", None
    sets = motion_sets()
    for path in find_clips(folder) if folder else ():
        if sets.may_train(path) and not path.name.startswith(UNNATURAL):
            yield f"training-{path.stem}", path


def _load(name: str, path: Path | None, index: int) -> Clip:
    if path is not None:
        return load_clip(path)
    return make_motion(name.split("-")[1], SECONDS, np.random.default_rng(FIRST_SEED + index))
