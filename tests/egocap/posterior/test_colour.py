"""The images' say enters the density as the colour term's own energy does, with its sign."""

from types import SimpleNamespace

import numpy as np

from egocap.posterior.colour import ColourLikelihood
from egocap.posterior.config import PosteriorConfig
from egocap.posterior.log_prob import log_posterior_of
from egocap.posterior.simulation import draw_detections, draw_poses


class Term:
    """Stands for a ColourTerm: its energy is the squared distance from the pose it was shown."""

    weight = 3.0

    def __init__(self):
        self.model = self

    def see(self, images, pose):
        assert len(images) == 2
        return pose

    def evaluate(self, pose, seen):
        return SimpleNamespace(energy=float(np.sum((pose - seen) ** 2)))


def test_colour_adds_minus_its_weighted_energy(rig, person):
    rng, config = np.random.default_rng(0), PosteriorConfig(model_error_m=0.0)
    poses = draw_poses(5, config, rng)
    found = draw_detections(poses, np.ones((5, 2, 18), bool), rig, person, 2.0, config, rng)
    said = ColourLikelihood(Term(), [np.zeros((4, 4, 3), np.uint8)] * 2, poses[0])
    alone = log_posterior_of(found, 0, rig, person, config)
    both = log_posterior_of(found, 0, rig, person, config, extra=said)
    expected = -3.0 * np.sum((poses - poses[0]) ** 2, axis=1)
    np.testing.assert_allclose(both(poses) - alone(poses), expected, atol=1e-9)
