"""A frame's images enter the density as minus the colour term's energy."""

from types import SimpleNamespace

import numpy as np

from egocap.data.sequence import open_sequence
from egocap.detect.sources import detections_from
from egocap.posterior import frame_posterior, sampler
from egocap.posterior.config import PosteriorConfig
from egocap.posterior.frame_posterior import (
    colour_likelihood,
    learned_likelihood,
    sample_posterior,
)
from egocap.posterior.log_prob import make_log_posterior
from egocap.posterior.synthetic_pose import draw_detections, draw_poses
from egocap.track.tracker import Tracker


class Term:
    """Stands for a ColourTerm: its energy is the squared distance from the pose it was shown."""

    weight = 3.0

    def __init__(self):
        self.model = self

    def set_images(self, images, pose):
        assert len(images) == 2
        return pose

    def evaluate(self, pose, seen):
        return SimpleNamespace(energy=float(np.sum((pose - seen) ** 2)))


def test_colour_adds_minus_its_weighted_energy(rig, person):
    rng, config = np.random.default_rng(0), PosteriorConfig(model_error_m=0.0)
    poses = draw_poses(5, config, rng)
    found = draw_detections(poses, np.ones((5, 2, 18), bool), rig, person, 2.0, config, rng)
    likelihood = colour_likelihood(Term(), [np.zeros((4, 4, 3), np.uint8)] * 2, poses[0])
    alone = make_log_posterior(found, 0, rig, person, config)
    both = make_log_posterior(found, 0, rig, person, config, extra=likelihood)
    expected = -3.0 * np.sum((poses - poses[0]) ** 2, axis=1)
    np.testing.assert_allclose(both(poses) - alone(poses), expected, atol=1e-9)


def test_a_frame_prefers_the_pose_that_it_shows(tiny_sequence):
    footage = open_sequence(tiny_sequence)
    found = detections_from(footage, "simulated:1", 0)
    said = learned_likelihood(footage, found, 1)
    pose = Tracker(footage.rig, footage.body).track(found).angles[1]
    away = pose + np.random.default_rng(0).normal(0.0, 0.3, (8, 37))
    assert (said(pose[None]) > said(away)).all()


def test_images_enter_the_density_only_when_asked(tiny_sequence, monkeypatch):
    footage = open_sequence(tiny_sequence)
    found = detections_from(footage, "simulated:1", 0)
    extras = []
    monkeypatch.setattr(sampler, "sample", lambda density, *_, **__: extras.append(density.extra))
    for colour in (False, True):
        sample_posterior(footage, 1, found, colour=colour)
    assert extras[0] is None
    assert extras[1] is not None


def test_start_pose_from_detections_with_modes(tiny_sequence, monkeypatch):
    footage = open_sequence(tiny_sequence)
    found = detections_from(footage, "simulated:1,wrong=0.2,modes=1", 0)
    assert found.modes is not None and len(found.times) > 3
    starts = []
    monkeypatch.setattr(sampler, "sample", lambda *_, **options: starts.append(options["starts"]))
    monkeypatch.setattr(frame_posterior, "CONTEXT", 1)  # fewer frames than the sequence has
    sample_posterior(footage, 1, found)
    assert starts[0].shape == (1, 37)
