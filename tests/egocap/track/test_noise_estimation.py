"""Accuracy read off residuals: known factors are found again, and never below what was stated."""

from dataclasses import replace

import numpy as np
import pytest

from egocap.pose.config import TrackerConfig
from egocap.pose.observations import observe
from egocap.track.noise_estimation import independent, lasting, measure_accuracy, recalibrated
from egocap.track.tracker import track
from tests.egocap.conftest import make_motion

CONFIG = TrackerConfig(model_error_m=0.0)


@pytest.fixture(scope="module")
def long_motion():
    return make_motion(frames=240, seed=2)


def measured(motion, source):
    seen = observe(motion.detect(source), motion.rig, motion.person, CONFIG)
    return measure_accuracy(motion.angles, seen, motion.person), seen


def gain(motion, source):
    """Mean error without recalibration over that with it, a third of the joints hidden."""
    found = motion.detect(source, hidden=0.3)
    without, with_ = (
        motion.errors(track(found, motion.rig, motion.person,
                            TrackerConfig(recalibrate=on, lambda_motion=0.0))).mean()
        for on in (False, True)
    )  # fmt: skip
    return without / with_


def test_honest_detections_are_left_alone(long_motion):
    accuracy, _ = measured(long_motion, "simulated:2")
    assert accuracy.widening.mean() < 1.05
    assert accuracy.correlation < 0.05
    assert not replace(accuracy, widening=np.ones(18)).matters


@pytest.mark.parametrize("factor", [2.0, 3.0])
def test_overconfidence_is_found(long_motion, factor):
    accuracy, seen = measured(long_motion, f"simulated:4,overconfidence={factor}")
    assert accuracy.widening.mean() == pytest.approx(factor, rel=0.08)
    assert accuracy.matters
    again = measure_accuracy(long_motion.angles, recalibrated(seen, accuracy), long_motion.person)
    assert again.widening.mean() < 1.1


def test_modesty_is_not_punished(long_motion):
    accuracy, _ = measured(long_motion, "simulated:4,overconfidence=0.5")
    assert (accuracy.widening == 1.0).all()


def test_memory_is_found(long_motion):
    accuracy, _ = measured(long_motion, "simulated:2,correlation=0.1")
    assert accuracy.correlation == pytest.approx(np.exp(-1 / 3), abs=0.1)
    assert accuracy.share == pytest.approx((1 - accuracy.correlation) / (1 + accuracy.correlation))


def test_memory_costs_all_of_its_certainty_and_half_of_its_say(long_motion):
    accuracy, seen = measured(long_motion, "simulated:2,correlation=0.3")
    assert accuracy.share < 0.2
    smoothed = recalibrated(seen, accuracy)
    assert np.allclose(smoothed.weights, np.sqrt(accuracy.share) * seen.weights)
    assert np.allclose(independent(smoothed, accuracy).weights, accuracy.share * seen.weights)


def test_lasting_errors_do_not_let_a_limb_go_astray(long_motion):
    """One view takes a stranger's arm for the wearer's; the errors of all joints last for long."""
    assert gain(long_motion, "simulated:3,correlation=1.0,wrong=0.15") > 1 / 1.1


def test_it_pays_where_the_detector_boasts(long_motion):
    assert gain(long_motion, "simulated:4,overconfidence=3,correlation=0.1") > 1 / 0.95


def test_too_little_to_tell_is_as_stated(long_motion):
    seen = observe(long_motion.detect("simulated:2"), long_motion.rig, long_motion.person, CONFIG)
    accuracy = measure_accuracy(long_motion.angles[:1], seen[:1], long_motion.person)
    assert (accuracy.widening == 1.0).all() and accuracy.correlation == 0.0


def test_errors_that_last_are_told_from_those_that_do_not():
    rng = np.random.default_rng(0)
    shape, seen = (4000, 1, 2, 2), np.ones((4000, 1, 2), bool)
    new = rng.standard_normal(shape)
    old = new.copy()
    for t in range(1, len(old)):
        old[t] = 0.8 * old[t - 1] + 0.6 * new[t]
    assert abs(lasting(old, seen) - 0.8) < 0.03
    assert lasting(new, seen) < 0.03
    seen[1::2] = False
    assert lasting(old, seen) == 0.0  # no two successive frames
