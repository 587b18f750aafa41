"""Covariances against dense inverses and against the errors that really happen."""

import numpy as np
import pytest

from egocap.body.skeleton import AGILITY, jacobian
from egocap.pose import kernel
from egocap.pose.banded import banded_inverse
from egocap.pose.config import TrackerConfig
from egocap.pose.energy import acceleration_stencil
from egocap.pose.motion_prior import NO_MOTION_PREDICTION
from egocap.pose.observations import observe
from egocap.track import smoother
from egocap.track.tracker import Tracker
from egocap.track.uncertainty import confidences, joint_covariances
from tests.egocap.conftest import make_motion

CONFIG = TrackerConfig()


@pytest.mark.parametrize("frames", [1, 2, 5])
def test_blocks_of_the_inverse_against_the_dense_one(motion, frames):
    seen = observe(motion.detect("simulated:2"), motion.rig, motion.person, CONFIG)[:frames]
    model = kernel.make_model(motion.person, CONFIG)
    size = frames * 37
    bands, g = np.zeros((75, size), order="F"), np.zeros(size)
    smoother.assemble(
        model, motion.angles[:frames], seen.arrays, 5.0, acceleration_stencil(seen.times), AGILITY,
        NO_MOTION_PREDICTION.mean, NO_MOTION_PREDICTION.precision, bands, g,
    )  # fmt: skip
    dense = np.zeros((size, size))
    for k in range(min(75, size)):
        dense += np.diag(bands[k, : size - k], -k)
    dense += np.tril(dense, -1).T
    inverse = np.linalg.inv(dense)
    expected = [inverse[i : i + 37, i : i + 37] for i in range(0, size, 37)]
    assert np.allclose(banded_inverse(bands, 37), expected, rtol=1e-6, atol=1e-12)


def test_joint_covariances_are_the_angles_ones_times_the_jacobians(motion):
    angles, halves = motion.angles[:3], np.random.default_rng(0).normal(size=(3, 37, 37))
    covariances = halves @ np.swapaxes(halves, 1, 2)
    _, J = jacobian(motion.person, angles)
    expected = np.einsum("tjad,tde,tjbe->tjab", J, covariances, J) + 0.02**2 * np.eye(3)
    found = joint_covariances(motion.person, angles, covariances, 0.02)
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize("smoothing_kind", ["interval", "none"])
def test_covariance_covers_the_errors(smoothing_kind):
    """Normalised squared errors of a Gaussian in space have the median 2.37."""
    ratios = []
    for seed in range(3):
        made = make_motion(frames=120, seed=seed)
        found = made.detect("simulated:3", hidden=0.4, seed=seed)
        result = Tracker(made.rig, made.person, TrackerConfig(smoothing=smoothing_kind)).track(
            found
        )
        error = (result.joints_head - made.joints)[:, 1:]
        inverse = np.linalg.inv(result.covariance[:, 1:])
        ratios.append(np.einsum("tji,tjik,tjk->tj", error, inverse, error))
    assert 0.3 < np.median(ratios) < 4.0
    assert np.mean(np.array(ratios) < 16.3) > 0.95  # 99.9 % of a Gaussian's


def test_what_is_hidden_is_less_sure(motion):
    found = motion.detect("simulated:2")
    valid = found.valid.copy()
    valid[30:60, :, 10:] = False
    from dataclasses import replace

    result = Tracker(motion.rig, motion.person).track(replace(found, valid=valid))
    legs = result.confidence[:, 11:]
    assert legs[40:50].mean() < legs[:20].mean() - 0.2
    assert result.confidence[:, 1:10].min() > 0.9


def test_confidence_is_the_chance_of_five_centimetres():
    rng = np.random.default_rng(0)
    for deviation in (0.01, 0.03, 0.1):
        covariance = np.tile(deviation**2 * np.eye(3), (1, 18, 1, 1))
        lengths = np.linalg.norm(deviation * rng.standard_normal((200_000, 3)), axis=-1)
        assert confidences(covariance)[0, 0] == pytest.approx((lengths < 0.05).mean(), abs=0.005)


def test_nothing_seen_is_not_believed(motion):
    found = motion.detect("simulated:2", hidden=1.0)
    result = Tracker(motion.rig, motion.person).track(found)
    assert np.isfinite(result.covariance).all()
    assert result.confidence[:, [5, 9, 12, 13, 16, 17]].max() < 0.3


def test_it_can_be_left_out(motion):
    result = Tracker(motion.rig, motion.person, TrackerConfig(covariance=False)).track(
        motion.detect("simulated:2")
    )
    assert result.covariance is None and result.confidence is None
