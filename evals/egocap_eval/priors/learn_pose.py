"""Learn the tracker's pose prior: `python -m egocap_eval.priors.learn_pose FOLDER`.

Every clip is retargeted to a simulated person; the tracker's angles are fitted to its joints, seen
exactly from four sides; mean and covariance of the angles are written to a file.
`python -m egocap_eval.priors.learn_motion` learns the motion prior likewise.
"""

from __future__ import annotations

import argparse
import logging
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.proportions import Proportions
from egocap.body.skeleton import forward
from egocap.errors import EgocapError
from egocap.geometry import inverse, transform, unit
from egocap.pose import kernel
from egocap.pose.config import TrackerConfig
from egocap.pose.observations import Observations, tangent_basis
from egocap.pose.pose_prior import FILE, learn_posture, save_posture
from egocap.track import online_filter, smoother
from egocap_sim.core.bodies import INDEX
from egocap_sim.human.body.person import Person
from egocap_sim.human.clothing.wardrobe import make_person
from egocap_sim.motion.clips.load import load_clip
from egocap_sim.motion.retarget.retarget import retarget
from egocap_sim.physics.simulation import simulate
from egocap_sim.truth.proportions import measure_proportions
from egocap_sim.truth.truth import label_positions

log = logging.getLogger(__name__)

HELD_OUT = ("07_", "007_", "walking_4", "basketball_signal_3")
"""Beginnings of the names of clips kept for validation."""
UNNATURAL = ("005_",)
"""Clips whose feet point where no foot can."""
FPS, MOST_FRAMES, PEOPLE = 30.0, 400, 6
ACCURACY = 0.004  # rad
_EYES = np.array([[0.24, 0.18, 0.16], [0.24, -0.18, 0.16], [0.5, 0.0, -1.0], [-0.5, 0.8, -0.5]])
# The priors stay weak: the angles are to come from the joints.
_CONFIG = TrackerConfig(lambda_posture=0.0, lambda_pose=0.02, acceleration_sigma=20.0)


def fit_angles(
    joints_head: Float[Array, "T 18 3"], proportions: Proportions
) -> Float[Array, "T 37"]:
    """Angles that bring the tracker's skeleton closest to known joints."""
    rays = unit(joints_head[:, None] - _EYES[None, :, None])
    whiten = tangent_basis(rays) / ACCURACY
    times = np.arange(len(rays)) / FPS
    observations = Observations(times, _EYES, rays, whiten, np.ones(rays.shape[:3]))
    model = kernel.make_model(proportions, _CONFIG)
    angles, _ = online_filter.filter_both_ways(observations, model, _CONFIG)
    return smoother.smooth_interval(angles, observations, model, _CONFIG)[0]


def joints_of(clip: Path, person: Person) -> Float[Array, "T 18 3"]:
    """Joints of a person doing a clip, head frame."""
    reference = retarget(load_clip(clip), person)
    frames = min(MOST_FRAMES, int(reference.duration_s * FPS))
    bodies = simulate(person, reference, fps=FPS, n_frames=frames).T_world_body
    return transform(inverse(bodies[:, INDEX["head"]]), label_positions(person, bodies))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="folder of .bvh and .npz motions, searched whole")
    parser.add_argument("--out", type=Path, default=FILE)
    options = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    people = [make_person(seed) for seed in range(10, 10 + PEOPLE)]
    motions = []
    for clip in sorted([*options.folder.rglob("*.bvh"), *options.folder.rglob("*.npz")]):
        if clip.name.startswith(HELD_OUT + UNNATURAL):
            continue
        person = people[len(motions) % PEOPLE]
        try:
            joints = joints_of(clip, person)
        except EgocapError as error:
            log.warning("%s left out: %s", clip.name, error)
            continue
        proportions = measure_proportions(person)
        angles = fit_angles(joints, proportions)
        error = np.linalg.norm(forward(proportions, angles) - joints, axis=-1).mean()
        log.info("%s: %d frames, fitted to %.1f mm", clip.name, len(angles), 1e3 * error)
        motions.append(angles)
    save_posture(*learn_posture(motions), options.out)


if __name__ == "__main__":
    main()
