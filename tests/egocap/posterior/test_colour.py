"""The images' say enters the density as the colour term's own energy does, with its sign."""

from types import SimpleNamespace

import numpy as np

from egocap.data.sequence import open_sequence
from egocap.detect.sources import detections_from
from egocap.posterior import sampler
from egocap.posterior.colour import ColourLikelihood, colour_likelihood
from egocap.posterior.config import PosteriorConfig, SamplerConfig
from egocap.posterior.log_prob import log_posterior_of
from egocap.posterior.run import sample_frame
from egocap.posterior.synthetic_pose import draw_detections, draw_poses
from egocap.track.tracker import track


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


def test_a_frame_prefers_the_pose_that_it_shows(tiny_sequence):
    footage = open_sequence(tiny_sequence)
    found = detections_from(footage, "simulated:1", 0)
    said = colour_likelihood(footage, found, 1)
    pose = track(found, footage.rig, footage.proportions).angles[1]
    away = pose + np.random.default_rng(0).normal(0.0, 0.3, (8, 37))
    assert (said(pose[None]) > said(away)).all()


def test_the_command_lets_the_images_speak_when_asked(tiny_sequence, monkeypatch):
    footage = open_sequence(tiny_sequence)
    found = detections_from(footage, "simulated:1", 0)
    heard = []
    monkeypatch.setattr(sampler, "sample", lambda density, *_, **__: heard.append(density.extra))
    for colour in (False, True):
        sample_frame(footage, found, 1, PosteriorConfig(), SamplerConfig(), colour=colour)
    assert heard[0] is None
    assert isinstance(heard[1], ColourLikelihood)
