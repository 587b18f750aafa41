"""Draws follow the prior and the likelihood."""

import numpy as np
import pytest

from egocap.body.skeleton import LIMITS
from egocap.errors import InputError
from egocap.pose.pose_prior import load_posture
from egocap.posterior.config import PosteriorConfig
from egocap.posterior.synthetic_pose import draw_detections, draw_noise, draw_poses


def test_poses_follow_the_gaussian_cut_by_the_walls():
    soft = PosteriorConfig(limit_weight=1e-9)
    poses = draw_poses(20_000, soft, np.random.default_rng(0))
    posture = load_posture()
    z = (poses - posture.mean) @ np.linalg.cholesky(posture.precision)
    assert np.abs(np.cov(z.T) - np.eye(37)).max() < 0.05
    hard = draw_poses(2000, PosteriorConfig(limit_weight=1e6), np.random.default_rng(0))
    assert (hard > LIMITS[:, 0] - 0.01).all() and (hard < LIMITS[:, 1] + 0.01).all()


@pytest.mark.parametrize("degrees", [5.0, np.inf])
def test_noise_has_unit_variance_and_the_tails_asked_for(degrees):
    noise = draw_noise((200_000,), degrees, np.random.default_rng(1))
    np.testing.assert_allclose(noise.std(0), 1.0, atol=0.03)
    # P(|e| > 4): Gaussian exp(-8), Student-t (1 + 16 / (nu - 2))^(-nu / 2).
    beyond = np.mean(np.linalg.norm(noise, axis=1) > 4.0)
    expected = np.exp(-8.0) if np.isinf(degrees) else (1 + 16 / (degrees - 2)) ** (-degrees / 2)
    assert beyond == pytest.approx(expected, rel=0.1, abs=1e-4)


def test_refuses_what_the_likelihood_does_not_describe(rig, person):
    rng = np.random.default_rng(0)
    poses, seen = np.zeros((1, 37)), np.ones((1, 2, 18), bool)
    with pytest.raises(InputError, match="model error"):
        draw_detections(poses, seen, rig, person, 2.0, PosteriorConfig(), rng)
    with pytest.raises(InputError, match=r"sigma 0\.1"):
        config = PosteriorConfig(model_error_m=0.0)
        draw_detections(poses, seen, rig, person, 0.1, config, rng)
