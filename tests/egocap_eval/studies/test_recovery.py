"""Recovery: wrong poses are wrong, and detections bring the tracker back."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from egocap.body.skeleton import LIMITS
from egocap.data.sequence import open_sequence
from egocap.detect.sources import detections_from
from egocap.errors import InputError
from egocap.pose.inverse_kinematics import nearest_angles
from egocap_eval.studies.recovery import (
    FOUND_MM,
    LIT_S,
    LOST_MM,
    MISLED_FRAMES,
    WORST_MM,
    ColourFollower,
    after_darkness,
    by_colours,
    by_detections,
    draw_trials,
)
from tests.egocap.conftest import make_motion

FRAMES = 4


@pytest.fixture
def footage(tiny_sequence):
    return open_sequence(tiny_sequence)


@pytest.fixture
def trials(footage):
    return list(draw_trials(footage, 2, FRAMES, np.random.default_rng(3)))


def test_trials_begin_lost_within_the_sequence(footage, trials):
    for trial in trials:
        assert LOST_MM <= trial.error_mm <= WORST_MM
        assert MISLED_FRAMES <= trial.frame <= len(footage) - FRAMES
        assert (trial.angles >= LIMITS[:, 0]).all() and (trial.angles <= LIMITS[:, 1]).all()
    again = list(draw_trials(footage, 2, FRAMES, np.random.default_rng(3)))
    assert np.array_equal(trials[0].angles, again[0].angles)


def test_short_sequences_are_refused(footage):
    with pytest.raises(InputError, match="7 frames"):
        next(draw_trials(footage, 2, 30, np.random.default_rng(3)))


def test_detections_bring_the_tracker_back(footage, trials):
    found = detections_from(footage, "simulated:1.0", 0)
    assert by_detections(footage, found, trials[0], FRAMES) < FOUND_MM


def test_without_detections_the_tracker_is_led_astray(footage, trials):
    found = detections_from(footage, "simulated:1.0", 0)
    nothing = replace(found, valid=np.zeros_like(found.valid))
    assert by_detections(footage, nothing, trials[0], FRAMES) > FOUND_MM


def test_colours_alone_follow_from_a_given_pose(footage, trials):
    truth = footage.truth.joints_head
    angles = np.array([nearest_angles(footage.body, joints) for joints in truth])
    error = by_colours(footage, ColourFollower(footage, angles), trials[0], 2)
    assert np.isfinite(error)


def test_recovery_from_darkness_is_timed():
    made = make_motion(90, seed=5)
    truth = SimpleNamespace(joints_head=made.joints)
    footage = SimpleNamespace(rig=made.rig, body=made.person, truth=truth)
    found = made.detect("simulated:2")
    score = after_darkness(footage, found)
    assert 0.0 <= score["recovery_s"] <= 0.3
    assert score["usual_mm"] <= score["after_mm"] < score["dark_mm"]
    assert set(after_darkness(footage, found[:70]).values()) == {None}
    assert LIT_S > 0.3
