"""Tracks of takes without a motion prior: what the network corrects."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from threadpoolctl import threadpool_limits

from egocap.body.labels import EVALUATED, MIRROR, other_side
from egocap.body.proportions import Proportions
from egocap.body.skeleton import MIRROR_DOFS, MIRROR_SIGNS, POINT_INDEX, POINTS, forward
from egocap.cameras.rig import Rig
from egocap.cameras.rig_files import load_rig
from egocap.commandline import progress
from egocap.data.detections import Detections
from egocap.data.head_pose import HeadPoses
from egocap.files import make_folder, read_npz, write_npz
from egocap.pose.config import TrackerConfig
from egocap.pose.kernel import make_model
from egocap.pose.observations import observe
from egocap.track.batch_solver import BatchSolver
from egocap.track.stopwatch import Stopwatch
from egocap.track.uncertainty import joint_deviations
from egocap_eval.priors.guesses import guess_detections
from egocap_eval.priors.takes import FPS, Take
from egocap_sim.core.resources import builtin_file

RIGS = (*["egorig1"] * 6, "egorig2", "glasses", "headset4", "cap")
SIZE = (640, 512)
_MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])
_MIRROR_POINTS = [POINT_INDEX.get(other_side(name), i) for i, name in enumerate(POINTS)]
CONFIG = TrackerConfig(lambda_motion=0.0)


@dataclass(frozen=True, eq=False)
class LearningTrack:
    """A track with errors, and the truth."""

    name: str
    angles: Float[Array, "T 37"]  # as tracked, rad
    std: Float[Array, "T 18"]  # of its joints, m
    truth: Float[Array, "T 37"]
    T_world_head: Float[Array, "T 4 4"]
    offsets: Float[Array, "22 3"]

    @property
    def person(self) -> Proportions:
        """The person's proportions."""
        return Proportions(self.offsets)

    @property
    def heads(self) -> HeadPoses:
        """The head's true poses."""
        return HeadPoses(self.T_world_head, np.ones(len(self.angles), bool))

    @property
    def error_mm(self) -> float:
        """Mean error of the joints, mm."""
        away = forward(self.person, self.angles) - forward(self.person, self.truth)
        return 1e3 * float(np.linalg.norm(away[:, EVALUATED], axis=-1).mean())

    @property
    def times(self) -> Float[Array, "T"]:
        """Times of the frames, s."""
        return np.arange(len(self.angles)) / FPS

    @property
    def mirrored(self) -> LearningTrack:
        """Left and right exchanged."""
        return LearningTrack(
            self.name, self.angles[:, MIRROR_DOFS] * MIRROR_SIGNS, self.std[:, MIRROR],
            self.truth[:, MIRROR_DOFS] * MIRROR_SIGNS, _MIRROR @ self.T_world_head @ _MIRROR,
            self.offsets[_MIRROR_POINTS] * [1.0, -1.0, 1.0],
        )  # fmt: skip


def guessed_tracks(takes: Sequence[Take], draws: int, keep: Path | None) -> list[LearningTrack]:
    """Tracks of all takes, each `draws` times with other errors and on other rigs.

    Those in the folder `keep` are read from there, the others written to it.
    """
    todo = [(take, draw) for draw in range(draws) for take in takes]
    tracks = []
    with progress("tracks", len(todo), unit="tracks") as advance:
        for take, draw in todo:
            rng = np.random.default_rng([draw, *take.name.encode()])
            kept = keep and keep / f"{take.name}.{draw}.npz"
            tracks.append(kept_track(take.name, kept, lambda t=take, r=rng: track_take(t, r)))
            advance()
    return tracks


def kept_track(name: str, kept: Path | None, make: Callable[[], LearningTrack]) -> LearningTrack:
    """The track in a file; without the file it is made, and written there. Raises as `make`."""
    if kept is not None and kept.is_file():
        found = read_npz(kept)
        names = ("angles", "std", "truth", "T_world_head", "offsets")
        return LearningTrack(name, *(found[key].astype(float) for key in names))
    made = make()
    if kept is not None:
        make_folder(kept.parent)
        write_npz(kept, **{key: a for key, a in vars(made).items() if key != "name"})
    return made


def track_take(take: Take, rng: np.random.Generator) -> LearningTrack:
    """A track of a take on a rig drawn from `RIGS`."""
    rig = load_rig(builtin_file("rig", str(rng.choice(RIGS)))).resized(*SIZE)
    return track_detections(take, guess_detections(take, rig, rng), rig)


def track_detections(take: Take, found: Detections, rig: Rig) -> LearningTrack:
    """The track of a take from its detections."""
    person = take.person
    with threadpool_limits(1, user_api="blas"):
        solver = BatchSolver(person, make_model(person, CONFIG), CONFIG)
        solution = solver.solve(observe(found, rig, person, CONFIG), Stopwatch())
        std = joint_deviations(
            person, solution.angles, solver.covariances(solution), CONFIG.model_error_m
        )
    return LearningTrack(
        take.name, solution.angles, std, take.angles, take.T_world_head, take.offsets
    )


def both_ways(tracks: Sequence[LearningTrack]) -> Iterator[LearningTrack]:
    """The tracks and their mirror images."""
    for track in tracks:
        yield track
        yield track.mirrored
