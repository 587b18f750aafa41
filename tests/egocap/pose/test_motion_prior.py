"""The learned process: conditioning against dense algebra, and what it is for."""

from dataclasses import replace

import numpy as np
import pytest

from egocap.body.skeleton import DOF_INDEX
from egocap.errors import FileError
from egocap.pose import kernel
from egocap.pose.config import TrackerConfig
from egocap.pose.motion_prior import (
    LAGS,
    MotionPrediction,
    condition,
    learn_motion_prior,
    load_motion_prior,
    predict_motion,
    save_motion_prior,
)
from egocap.pose.observations import observe
from egocap.track.tracker import Tracker

A, B = DOF_INDEX["neck_flexion"], DOF_INDEX["upper_spine_flexion"]  # the same in a mirror


def test_shipped_prior_is_a_possible_process():
    prior = load_motion_prior()
    assert prior.window.shape == (37 * LAGS, 37 * LAGS)
    assert np.linalg.eigvalsh(prior.window)[0] > 0
    assert np.allclose(prior.window, prior.window.T)


@pytest.mark.parametrize("knots", [1, 4, LAGS])
def test_conditioning_against_dense_algebra(knots):
    prior, rng = load_motion_prior(), np.random.default_rng(0)
    halves = rng.normal(size=(knots, 37, 3)) * 5
    information = halves @ np.swapaxes(halves, 1, 2)
    targets = np.einsum("tij,tj->ti", information, rng.normal(size=(knots, 37)))
    size = 37 * knots
    dense = np.zeros((size, size))
    for k in range(knots):
        dense[37 * k : 37 * k + 37, 37 * k : 37 * k + 37] = information[k]
    expected = np.linalg.inv(np.linalg.inv(prior.window[:size, :size]) + dense)
    means, covariances = condition(information, targets, prior)
    assert np.allclose(means.ravel(), expected @ targets.ravel(), atol=1e-6)
    for k in range(knots):
        block = expected[37 * k : 37 * k + 37, 37 * k : 37 * k + 37]
        assert np.allclose(covariances[k], block, atol=1e-7)


def test_swinging_is_learned_and_fills_gaps(tmp_path):
    """Two angles that swing against each other: one tells the other, at any moment."""
    rng, times = np.random.default_rng(1), np.arange(400) / 30
    motions = []
    for _ in range(30):
        phase, size = rng.uniform(0, 2 * np.pi), rng.uniform(0.3, 0.6)
        motion = np.zeros((400, 37))
        motion[:, A] = size * np.sin(2 * np.pi * times + phase)
        motion[:, B] = -motion[:, A]
        motions.append(motion)
    prior = learn_motion_prior(motions, 30.0)
    save_motion_prior(prior, tmp_path / "p.npz")
    prior = load_motion_prior(tmp_path / "p.npz")
    shown = motions[0][::3][:LAGS]
    information = np.zeros((LAGS, 37, 37))
    information[:, B, B] = 1e4
    targets = np.zeros((LAGS, 37))
    targets[:, B] = 1e4 * (shown - prior.mean)[:, B]
    means, _ = condition(information, targets, prior)
    assert np.abs(means[:, A] + prior.mean[A] - shown[:, A]).max() < 0.05


def test_damaged_files_are_refused(tmp_path):
    (tmp_path / "p.npz").write_bytes(b"PK nonsense")
    with pytest.raises(FileError, match="motion prior"):
        load_motion_prior(tmp_path / "p.npz")
    good = load_motion_prior()
    save_motion_prior(replace(good, covariances=-good.covariances), tmp_path / "q.npz")
    with pytest.raises(FileError, match="positive"):
        load_motion_prior(tmp_path / "q.npz")
    rng = np.random.default_rng(0)
    skewed, singular = good.covariances.copy(), good.covariances.copy()
    skewed[0, 3, 5] += 0.1
    singular[:, A] = singular[:, :, A] = 0.0
    random = rng.normal(size=good.covariances.shape)
    for covariances in (skewed, singular, random + np.swapaxes(random, 1, 2)):
        save_motion_prior(replace(good, covariances=covariances), tmp_path / "q.npz")
        with pytest.raises(FileError, match="'covariances': not positive definite"):
            load_motion_prior.__wrapped__(tmp_path / "q.npz")
    for value in (np.nan, 1e30):
        save_motion_prior(replace(good, mean=good.mean + value), tmp_path / "q.npz")
        with pytest.raises(FileError, match="not finite, or too large"):
            load_motion_prior.__wrapped__(tmp_path / "q.npz")


def test_guide_agrees_with_what_is_seen(motion):
    config = TrackerConfig()
    seen = observe(motion.detect("simulated:1"), motion.rig, motion.person, config)
    model = kernel.make_model(motion.person, config)
    guide = predict_motion(motion.angles, seen, model, config)
    assert guide.mean.shape == (90, 37)
    away = np.einsum("ti,tij,tj->t", guide.mean - motion.angles, guide.precision,
                     guide.mean - motion.angles)  # fmt: skip
    assert np.median(away) < 2 * 37


@pytest.mark.parametrize("step", [1 / 10, 1 / 60, 5.0])
def test_any_frame_rate_and_gaps(motion, step):
    found = motion.detect("simulated:2", hidden=0.3)
    times = step * np.arange(len(found.times))
    times[50:] += 30.0
    result = Tracker(motion.rig, motion.person).track(replace(found, times=times))
    assert np.isfinite(result.joints_head).all() and np.isfinite(result.covariance).all()
    assert np.median(motion.errors(result)) < 0.03


def test_a_guide_takes_another_in_some_frames():
    eye = np.broadcast_to(np.eye(37), (4, 37, 37))
    one, two = (
        MotionPrediction(np.zeros((4, 37)), eye),
        MotionPrediction(np.ones((4, 37)), 2.0 * eye),
    )
    both = one.replaced(two, np.array([False, True, True, False]))
    assert both.mean[:, 0].tolist() == [0, 1, 1, 0]
    assert both.precision[:, 5, 5].tolist() == [1, 2, 2, 1]
