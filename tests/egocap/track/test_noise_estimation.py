"""Accuracy read off residuals: known factors are found again, and never below what was stated."""

from dataclasses import replace

import numpy as np
import pytest

from egocap.pose.config import TrackerConfig
from egocap.pose.observations import observe
from egocap.track.noise_estimation import (
    apply_noise,
    autocorrelation,
    estimate_noise,
    weight_as_independent,
)
from egocap.track.tracker import Tracker
from tests.egocap.conftest import make_motion

CONFIG = TrackerConfig(model_error_m=0.0)


@pytest.fixture(scope="module")
def long_motion():
    return make_motion(frames=240, seed=2)


def measured(motion, source):
    seen = observe(motion.detect(source), motion.rig, motion.person, CONFIG)
    return estimate_noise(motion.angles, seen, motion.person), seen


def gain(motion, source):
    """Mean error without noise estimation over that with it, a third of the joints hidden."""
    found = motion.detect(source, hidden=0.3)
    without, with_ = (
        motion.errors(
            Tracker(motion.rig, motion.person, TrackerConfig(estimate_noise=on, lambda_motion=0.0))
            .track(found)
        ).mean()
        for on in (False, True)
    )  # fmt: skip
    return without / with_


def test_honest_detections_are_left_alone(long_motion):
    noise, _ = measured(long_motion, "simulated:2")
    assert noise.sigma_factor.mean() < 1.05
    assert noise.correlation < 0.05
    assert not replace(noise, sigma_factor=np.ones(18)).is_significant


@pytest.mark.parametrize("factor", [2.0, 3.0])
def test_overconfidence_is_found(long_motion, factor):
    noise, seen = measured(long_motion, f"simulated:4,overconfidence={factor}")
    assert noise.sigma_factor.mean() == pytest.approx(factor, rel=0.08)
    assert noise.is_significant
    again = estimate_noise(long_motion.angles, apply_noise(seen, noise), long_motion.person)
    assert again.sigma_factor.mean() < 1.1


def test_modesty_is_not_punished(long_motion):
    noise, _ = measured(long_motion, "simulated:4,overconfidence=0.5")
    assert (noise.sigma_factor == 1.0).all()


def test_memory_is_found(long_motion):
    noise, _ = measured(long_motion, "simulated:2,correlation=0.1")
    assert noise.correlation == pytest.approx(np.exp(-1 / 3), abs=0.1)
    assert noise.independent_fraction == pytest.approx(
        (1 - noise.correlation) / (1 + noise.correlation)
    )


def test_correlation_reduces_covariances_fully_and_smoothing_in_part(long_motion):
    noise, seen = measured(long_motion, "simulated:2,correlation=0.3")
    assert noise.independent_fraction < 0.2
    smoothed = apply_noise(seen, noise)
    assert np.allclose(smoothed.weights, noise.independent_fraction**0.25 * seen.weights)
    assert np.allclose(
        weight_as_independent(smoothed, noise).weights, noise.independent_fraction * seen.weights
    )


def test_correlated_errors_do_not_let_limbs_drift(long_motion):
    """One view takes a stranger's arm for the wearer's; the errors of all joints last for long."""
    assert gain(long_motion, "simulated:3,correlation=1.0,wrong=0.15") > 1 / 1.1


def test_noise_estimation_reduces_error_for_an_overconfident_detector(long_motion):
    assert gain(long_motion, "simulated:4,overconfidence=3,correlation=0.1") > 1 / 0.95


def test_few_detections_keep_the_stated_noise(long_motion):
    seen = observe(long_motion.detect("simulated:2"), long_motion.rig, long_motion.person, CONFIG)
    noise = estimate_noise(long_motion.angles[:1], seen[:1], long_motion.person)
    assert (noise.sigma_factor == 1.0).all() and noise.correlation == 0.0


def test_autocorrelation_of_correlated_and_white_noise():
    rng = np.random.default_rng(0)
    shape, seen = (4000, 1, 2, 2), np.ones((4000, 1, 2), bool)
    new = rng.standard_normal(shape)
    old = new.copy()
    for t in range(1, len(old)):
        old[t] = 0.8 * old[t - 1] + 0.6 * new[t]
    assert abs(autocorrelation(old, seen) - 0.8) < 0.03
    assert autocorrelation(new, seen) < 0.03
    seen[1::2] = False
    assert autocorrelation(old, seen) == 0.0  # no two successive frames
