"""Learn the tracker's motion prior: `python -m egocap_eval.priors.learn_motion FOLDER`.

Motions are the clips of a folder, without those kept for validation, and built-in motions of other
seeds, people and styles than any scene's. Each is acted out under physics by one of a dozen people;
the tracker's angles are fitted to the joints as `egocap_eval.priors.learn_pose` does.
"""

from __future__ import annotations

import argparse
import logging
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.errors import EgocapError
from egocap.geometry import inverse, transform
from egocap.pose.motion_prior import FILE, learn_motion_prior, save_motion_prior
from egocap_eval.priors.learn_pose import FPS, HELD_OUT, MOST_FRAMES, UNNATURAL, fit_angles
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

PEOPLE = range(310_000, 310_012)
FIRST_SEED = 320_000
SECONDS, SEQUENCE_SECONDS = 16.0, 40.0
BUILT_IN = (
    ["walk"] * 14 + ["gestures"] * 14 + ["sequence"] * 6
    + ["squat", "sit", "look_around", "idle", "dribble", "hold", "work", "juggle"] * 4
)  # fmt: skip


def clips_of(folder: Path | None) -> Iterator[tuple[Clip, int]]:
    """Motions to learn from, and the most frames of each that count."""
    for i, name in enumerate(BUILT_IN):
        seconds = SEQUENCE_SECONDS if name == "sequence" else SECONDS
        clip = make_motion(name, seconds, np.random.default_rng(FIRST_SEED + i))
        yield clip, int(seconds * FPS)
    for path in sorted([*folder.rglob("*.bvh"), *folder.rglob("*.npz")]) if folder else ():
        if not path.name.startswith(HELD_OUT + UNNATURAL):
            try:
                yield load_clip(path), MOST_FRAMES
            except EgocapError as error:
                log.warning("%s left out: %s", path.name, error)


def angles_of(clip: Clip, person: Person, most: int) -> Float[Array, "T 37"]:
    """The tracker's angles of a person doing a motion."""
    reference = retarget(clip, person)
    frames = min(most, int(reference.duration_s * FPS))
    bodies = simulate(person, reference, fps=FPS, n_frames=frames).T_world_body
    joints = transform(inverse(bodies[:, INDEX["head"]]), label_positions(person, bodies))
    return fit_angles(joints, measure_proportions(person))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", help="folder of .bvh and .npz motions")
    parser.add_argument("--out", type=Path, default=FILE)
    options = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    people = [make_person(seed) for seed in PEOPLE]
    motions = []
    for i, (clip, most) in enumerate(clips_of(options.folder)):
        try:
            motions.append(angles_of(clip, people[i % len(people)], most))
        except EgocapError as error:
            log.warning("%s left out: %s", clip.name, error)
            continue
        log.info("%s: %d frames", clip.name, len(motions[-1]))
    save_motion_prior(learn_motion_prior(motions, FPS), options.out)


if __name__ == "__main__":
    main()
